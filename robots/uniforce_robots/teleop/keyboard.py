"""Steer with the keys of a terminal, over ssh too: the target, or the width in hand guiding.

A terminal reports a key going down, never up: a key is a short pulse of speed, which its repetition
renews. LeRobot's ``TerminalKeyListener`` reads them. Never used on a real robot.
"""

import contextlib
import select
import sys
import termios
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig
from lerobot.utils.keyboard_input import TerminalKeyListener

from uniforce_robots.franka.arm import HAND_GUIDED
from uniforce_robots.teleop.base import FEEDBACK_AGE_S, UniforceTeleoperator
from uniforce_robots.teleop.integrator import SteeringConfig
from uniforce_vtla.errors import TeleoperatorError, expected
from uniforce_vtla.keys import AXES

PULSE_S = 0.12  # longer than a keyboard's repeat period (30 to 40 ms), short enough to stop
OTHERS_KEPT = 64  # keys of other meaning that wait to be taken
TEXT_ENDS = ("enter", "esc")
X, Y, Z, YAW, WIDTH = range(5)
WIDTH_KEYS = {"o": (WIDTH, 1), "p": (WIDTH, -1)}  # n, r, q and the arrows are left to a recorder
KEYS = {
    "w": (X, 1), "s": (X, -1), "a": (Y, 1), "d": (Y, -1),
    "e": (Z, 1), "c": (Z, -1), "j": (YAW, 1), "l": (YAW, -1),
    **WIDTH_KEYS,
}  # fmt: skip


class TerminalKeys:
    """Turn keys into speeds of axes; ``meanings``: key → (axis index, direction −1 or 1).

    Capitals mean the same. From the key ``text_begins`` to one of ``TEXT_ENDS`` nothing steers: the
    owner takes the typed keys, and may end the text by ``is_text``.
    """

    text_begins: str | None = None
    is_text = False

    def __init__(
        self, meanings: Mapping[str, tuple[int, int]], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._meanings = dict(meanings)
        self.clock = clock
        self._others: deque[str] = deque(maxlen=OTHERS_KEPT)
        self._until_s = dict.fromkeys(self._meanings, 0.0)  # when each key counts as let go
        self._dead: set[str] = set()  # keys that must be let go before they steer again
        self._listener: TerminalKeyListener | None = None

    @property
    def is_running(self) -> bool:
        """Whether keys are read."""
        return self._listener is not None

    def start(self) -> None:
        """Read keys from this terminal until ``stop``; TeleoperatorError: no terminal."""
        if not sys.stdin.isatty():
            do = "Run it in a terminal, not behind a pipe or in a notebook."
            raise TeleoperatorError(
                expected("keyboard", "a terminal", "another input", do), "connection"
            )
        self._listener = TerminalKeyListener(self.press)
        self._listener.start()

    def stop(self) -> None:
        """Give the terminal back. Safe to call twice."""
        listener, self._listener = self._listener, None
        if listener is not None:
            # the terminal hung up: nothing left to restore
            with contextlib.suppress(termios.error):
                listener.stop()

    def press(self, key: str) -> None:
        """Take one key; called by the listener's thread."""
        if self.is_text:
            self._others.append(key)
            self.is_text = key not in TEXT_ENDS
            return
        key = key.lower()
        if key in self._meanings:
            now_s = self.clock()
            if now_s >= self._until_s[key]:
                self._dead.discard(key)
            self._until_s[key] = now_s + PULSE_S
        else:
            self._others.append(key)
            self.is_text = key == self.text_begins
            if self.is_text:
                self.forget()

    def rates(self) -> np.ndarray:
        """Return (5,) direction of each axis now: −1, 0 or 1; TeleoperatorError: no terminal."""
        if self._listener is not None:
            _refuse_hung_up()
        rates = np.zeros(len(AXES))
        now_s = self.clock()
        for key, (axis, direction) in self._meanings.items():
            rates[axis] += direction * (now_s < self._until_s[key] and key not in self._dead)
        return np.clip(rates, -1, 1)

    def forget(self) -> None:
        """Ignore keys that are held now until they were let go: an episode starts at rest."""
        self._dead = set(self._meanings)

    def take_others(self) -> list[str]:
        """Return and forget keys that mean nothing here, e.g. a recorder's; small but in a text."""
        return [self._others.popleft() for _ in range(len(self._others))]


def _refuse_hung_up() -> None:
    poll = select.poll()
    poll.register(sys.stdin.fileno(), 0)
    if poll.poll(0):  # registered for no event: only POLLHUP, POLLERR, POLLNVAL come
        do = "Start the program again."
        raise TeleoperatorError(
            expected("keyboard", "a terminal", "one that hung up", do), "connection"
        )


@TeleoperatorConfig.register_subclass("uniforce_keyboard")
@dataclass(kw_only=True)
class UniforceKeyboardConfig(SteeringConfig):
    """Keys of a terminal."""


@TeleoperatorConfig.register_subclass("uniforce_hand_guide")
@dataclass(kw_only=True)
class UniforceHandGuideConfig(SteeringConfig):
    """A person leads the soft arm; the limits hold for the width alone."""


class UniforceKeyboard(UniforceTeleoperator):
    """Hold w s a d to move along base x and y, e c up and down, j l to turn, o p for the width."""

    config_class: type[TeleoperatorConfig] = UniforceKeyboardConfig
    name = "uniforce_keyboard"
    meanings: ClassVar[Mapping[str, tuple[int, int]]] = KEYS

    def __init__(self, config: TeleoperatorConfig) -> None:
        super().__init__(config)
        self.keys = self.device = TerminalKeys(self.meanings, lambda: self.clock())

    def _begin(self, measured: np.ndarray) -> None:
        self.keys.forget()

    def rates(self) -> np.ndarray:
        """Return (5,) direction of each axis: −1, 0 or 1."""
        return self.keys.rates()


class UniforceHandGuide(UniforceKeyboard):
    """The paper's way: the action is the measured x, y, z, yaw; keys o and p set the width.

    The arm needs ``HAND_GUIDED`` gains: soft but along the closing axis, so that a squeeze does not
    drag it. The target follows the measured pose, so nothing pulls the arm back; errors of its
    gravity model let it creep.
    """

    config_class = UniforceHandGuideConfig
    name = "uniforce_hand_guide"
    meanings = WIDTH_KEYS
    wants_gains = HAND_GUIDED

    def _next(self, elapsed_s: float) -> np.ndarray:
        measured = self.measured
        if measured is None:
            wanted = f"a measured pose younger than {FEEDBACK_AGE_S} s"
            do = "Call send_feedback(observation) before each get_action()."
            raise TeleoperatorError(expected("hand guiding", wanted, "none", do), "stale")
        return np.array([*measured[:WIDTH], super()._next(elapsed_s)[WIDTH]])
