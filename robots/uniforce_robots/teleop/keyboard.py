"""Steer with the keys of a terminal, over ssh too: the target, or the width alone while a person leads the soft arm.

A terminal says when a key goes down, never when it comes up: a key is a short pulse of speed, which its repetition
renews. LeRobot's ``TerminalKeyListener`` reads them. Never used on a real robot.
"""

import contextlib
import select
import sys
import termios
import time
from collections import deque
from collections.abc import Mapping
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

PULSE_S = 0.12  # longer than a keyboard's repeat period (30 to 40 ms), short enough to stop soon
OTHERS_KEPT = 64  # keys of other meaning that wait to be taken
X, Y, Z, YAW, WIDTH = range(5)
WIDTH_KEYS = {"o": (WIDTH, 1), "p": (WIDTH, -1)}  # n, r, q and the arrows are left to a recorder
KEYS = {
    "w": (X, 1), "s": (X, -1), "a": (Y, 1), "d": (Y, -1), "e": (Z, 1), "c": (Z, -1), "j": (YAW, 1), "l": (YAW, -1),
    **WIDTH_KEYS,
}  # fmt: skip


class TerminalKeys:
    """Turn keys into speeds of axes; ``meanings``: key → (axis index, direction −1 or 1)."""

    def __init__(self, meanings: Mapping[str, tuple[int, int]]) -> None:
        self._meanings = dict(meanings)
        self._others: deque[str] = deque(maxlen=OTHERS_KEPT)
        self.forget()
        self._listener: TerminalKeyListener | None = None

    @property
    def is_running(self) -> bool:
        """Whether keys are read."""
        return self._listener is not None

    def start(self) -> None:
        """Read keys from this terminal until ``stop``; TeleoperatorError where standard input is none."""
        if not sys.stdin.isatty():
            do = "Run it in a terminal, not behind a pipe or in a notebook."
            raise TeleoperatorError(expected("keyboard", "a terminal", "another input", do), "connection")
        self._listener = TerminalKeyListener(self.press)
        self._listener.start()

    def stop(self) -> None:
        """Give the terminal back. Safe to call twice."""
        listener, self._listener = self._listener, None
        if listener is not None:
            with contextlib.suppress(termios.error):  # the terminal hung up: nothing left to restore
                listener.stop()

    def press(self, key: str) -> None:
        """Take one key; called by the listener's thread."""
        if key.lower() in self._meanings:
            self._until_s[key.lower()] = time.monotonic() + PULSE_S
        else:
            self._others.append(key)

    def rates(self) -> np.ndarray:
        """(5,) direction of each axis now: −1, 0 or 1; TeleoperatorError where the terminal has gone."""
        poll = select.poll()
        poll.register(sys.stdin.fileno(), 0)
        if any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll(0)):
            do = "Start the program again."
            raise TeleoperatorError(expected("keyboard", "a terminal", "one that hung up", do), "connection")
        rates, now_s = np.zeros(len(AXES)), time.monotonic()
        for key, (axis, direction) in self._meanings.items():
            rates[axis] += direction * (now_s < self._until_s[key])
        return np.clip(rates, -1, 1)

    def forget(self) -> None:
        """Drop pulses that still run, so that an episode starts at rest."""
        self._until_s = dict.fromkeys(self._meanings, 0.0)

    def take_others(self) -> list[str]:
        """Return keys that mean nothing here, e.g. a recorder's own, and forget them."""
        return [self._others.popleft() for _ in range(len(self._others))]


@TeleoperatorConfig.register_subclass("uniforce_keyboard")
@dataclass(kw_only=True)
class UniforceKeyboardConfig(SteeringConfig):
    """Keys of a terminal."""


@TeleoperatorConfig.register_subclass("uniforce_hand_guide")
@dataclass(kw_only=True)
class UniforceHandGuideConfig(SteeringConfig):
    """A person leads the soft arm; the limits hold for the width alone."""


class UniforceKeyboard(UniforceTeleoperator):
    """w s a d along base x and y, e c up and down, j l turn, o p open and close; a held key moves on."""

    config_class: type[TeleoperatorConfig] = UniforceKeyboardConfig
    name = "uniforce_keyboard"
    meanings: ClassVar[Mapping[str, tuple[int, int]]] = KEYS

    def __init__(self, config: TeleoperatorConfig) -> None:
        super().__init__(config)
        self.keys = self.device = TerminalKeys(self.meanings)

    def _begin(self, measured: np.ndarray) -> None:
        self.keys.forget()

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self.integrator.advance(self.keys.rates(), elapsed_s, self.measured)


class UniforceHandGuide(UniforceKeyboard):
    """The paper's way: the measured x, y, z and yaw are the action; keys o (open) and p (close) set the width.

    The arm needs ``HAND_GUIDED`` gains: soft but along the closing axis, so that a squeeze does not drag it. Since the
    target follows the measured pose, nothing pulls the arm back; what its gravity model leaves over lets it creep.
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
