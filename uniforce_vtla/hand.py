"""The gripper: one command at a time, every closing with a bounded force, and a stop.

The real hand answers a command when its fingers have arrived and gives its state about ten times a
second. A control loop at 30 Hz can wait for neither.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from uniforce_vtla.errors import RobotError, SensorError, expected

log = logging.getLogger(__name__)
# a command may take its travel at the set speed and this much more: the hand begins slowly
GRACE_s = 0.5
LOST_s = 0.3  # three readings without hold, by the hand's own word: what was grasped counts as lost
# by which fingers close further than a grasp: it slips out, whatever the hand says
SLIPPED_m = 0.004
TRIES = 2  # of a command that did not succeed while its width is still wished
WIDEST_m = 0.12  # no hand opens so far
UNHOMED_m = 0.01  # a hand that was never homed gives no larger opening than this
THINNEST_m = 0.002  # of what may be grasped; fingers closer than this hold nothing
OUTER_m = 0.08  # outer tolerance of a grasp: the tool may be thicker than the target, on purpose


@dataclass(frozen=True)
class HandRules:
    """How widths become commands."""

    speed_m_s: float = 0.05  # of the fingers
    # of every closing; gels and domes are rated for about 11 N; the real hand's smallest force is
    # unverified
    grip_force_N: float = 10.0
    hysteresis_m: float = 0.003  # a smaller change of the wished width is no new command
    reading_age_s: float = 0.5  # an older reading stops the arm; the hand gives about ten a second


@dataclass(frozen=True)
class HandCommand:
    """Command to the hand: a grasp where ``force_N`` > 0, a plain move where it is 0."""

    width_m: float
    speed_m_s: float
    force_N: float = 0.0

    @property
    def grasp_width_m(self) -> float:
        """Width named in a grasp: fingers closed on nothing lie outside its tolerance."""
        return max(self.width_m, 2 * THINNEST_m)

    @property
    def inner_m(self) -> float:
        """Inner tolerance of a grasp: anything thicker than ``THINNEST_m`` counts as held."""
        return self.grasp_width_m - THINNEST_m


@dataclass(frozen=True)
class HandReading:
    """A reading of the hand."""

    time_s: float  # host clock at receipt
    width_m: float  # opening between the fingers
    max_width_m: float
    is_grasped: bool


class HandClient(Protocol):
    """A hand: the robot's, in a child process, or the scene's. No call but ``connect`` waits."""

    def connect(self) -> None:
        """Open the connection and wait for a first reading."""

    def read(self) -> HandReading | None:
        """Return the newest reading, None before the first."""

    def begin(self, command: HandCommand) -> None:
        """Start a command; none is in flight."""

    def poll(self) -> bool | None:
        """Return how the command ended (False: not done, nothing grasped); None while it runs."""

    def stop(self) -> None:
        """Stop the fingers where they are; a command in flight ends without success."""

    def refuse_closed(self) -> None:
        """Raise RobotError where the hand has closed the connection."""


def next_command(
    wish_m: float, width_m: float, holds: bool, settings: HandRules
) -> HandCommand | None:
    """Return the command from a width to a wished one, None where the fingers are there.

    Closing by position would press with all the motor has, so every closing is a grasp with a
    bounded force. Fingers that hold something are as close as they can be: only a wider wish
    moves them.
    """
    opens = wish_m > width_m
    if abs(wish_m - width_m) < settings.hysteresis_m or (holds and not opens):
        return None
    return HandCommand(wish_m, settings.speed_m_s, 0.0 if opens else settings.grip_force_N)


def require_open(reading: HandReading, open_width_m: float) -> None:
    """Refuse a free-air reference while the fingers may hold something.

    Raises SensorError: they hold something, or are closer than ``open_width_m``.
    """
    if reading.is_grasped or reading.width_m < open_width_m:
        came = "holding something" if reading.is_grasped else f"{reading.width_m * 1000:.0f} mm"
        do = "Open the gripper, then take the references again."
        raise SensorError(
            expected("free air", f"fingers ≥ {open_width_m * 1000:.0f} mm apart", came, do)
        )


class Hand:
    """Brings the fingers to the newest wished width, one command at a time.

    No call but ``start`` waits. The arm's stream ticks it, so that the hand's faults stop the arm.
    """

    def __init__(
        self,
        client: HandClient,
        settings: HandRules | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.settings = settings or HandRules()
        self.failed_commands = 0
        self._client = client
        self._clock = clock
        self._reading: HandReading | None = None
        self._wish_m: float | None = None  # None: nothing was wished since the last stop
        self._last: HandCommand | None = None  # None: nothing was asked for since the last stop
        self._tries = 0  # of the last command
        self._succeeded = False
        self.is_busy = False  # a command is in flight
        self._stop_wanted = self._interrupted = False
        self._deadline_s = self._ended_s = 0.0  # of the command in flight; when the last one ended
        self._holds = False  # the last command was a grasp that succeeded
        self._held_m: float | None = None  # how wide what was grasped is; None: nothing to lose
        self._held_s = 0.0  # when it was last there
        self._fault: RobotError | None = None

    def start(self) -> None:
        """Connect and read the hand once.

        Raises RobotError: no connection, no first reading, or it was never homed.
        """
        self._client.connect()
        self._take_reading()
        if self._reading is None:
            raise RobotError(
                "hand: expected a first reading, got none. Is the hand initialised?",
                "hand_connection",
            )
        widest_m = self._reading.max_width_m
        if widest_m < UNHOMED_m:
            came = f"a largest opening of {1000 * widest_m:.0f} mm"
            do = "Home the hand in Desk, then connect again."
            raise RobotError(expected("hand", "one that was homed", came, do), "hand_state")

    @property
    def reading(self) -> HandReading:
        """The newest reading, whatever its age.

        Raises RobotError: the hand has a fault.
        """
        if self._fault is not None:
            raise self._fault
        if self._reading is None:
            raise RobotError(
                "hand: expected start() first, got no reading. Connect the robot.", "ended"
            )
        return self._reading

    def submit(self, width_m: float) -> None:
        """Wish a width from now on; the newest one counts once the hand is free.

        Raises RobotError: the hand has a fault; ``guard``: a width outside 0 to ``WIDEST_m``.
        """
        if self._fault is not None:
            raise self._fault
        if not -THINNEST_m <= width_m <= WIDEST_m:
            do = "Not sent; please report it."
            raise RobotError(expected("width to send", f"0 to {WIDEST_m} m", width_m, do), "guard")
        self._wish_m = width_m

    def stop(self) -> None:
        """Stop at the next tick and forget the wish; a held object stays held. From any thread."""
        self._wish_m = None
        self._stop_wanted = True

    def halt(self) -> None:
        """Stop the fingers at once, for the end of the ticks; only in the thread that ticks.

        Raises RobotError: the client has gone, and the fingers stop with it.
        """
        self._wish_m = self._last = None
        self._interrupted = True
        if self.is_busy or not (self._reading and self._reading.is_grasped):
            self._client.stop()  # not where something is held: the hand might let go of it

    def tick(self) -> None:
        """Take reading and outcome, begin the next command, check; one thread at a time.

        Raises RobotError: as ``check``; a fault of the client stays until the robot connects again.
        """
        try:
            self._take_reading()
            if self.is_busy:
                self._finish(self._client.poll())
            else:
                self._begin()
            self._stop_if_due()
        except RobotError as fault:
            self._fault = self._fault or fault
        self.check()

    def check(self) -> None:
        """Raise what is wrong with the hand now.

        Raises RobotError: the hand's fault; ``hand_connection``: it has hung up; ``hand_deadline``:
        a command takes too long; ``hand_stale``: no new reading; ``grasp_lost``: it let go of what
        it held without being asked to.
        """
        if self._fault is not None:
            raise self._fault
        self._client.refuse_closed()
        if self.is_busy and self._clock() > self._deadline_s:
            wanted = f"an answer to {self._last or 'a stop'}"
            do = "Is something in its way? Free it, then connect again."
            raise RobotError(expected("hand", wanted, "none in time", do), "hand_deadline")
        held_m = self._held_m
        reading = self._reading
        if reading is None:
            return
        age_s = self._clock() - max(reading.time_s, self._ended_s)
        if age_s > self.settings.reading_age_s:
            wanted = f"a reading younger than {self.settings.reading_age_s} s"
            do = "Check the cable and the robot's controller."
            raise RobotError(expected("hand", wanted, f"{age_s:.2f} s", do), "hand_stale")
        if held_m is not None and reading.time_s - self._held_s > LOST_s:
            do = "Put it back into the fingers, then call recover()."
            raise RobotError(
                expected("hand", "what was grasped", "nothing any more", do), "grasp_lost"
            )

    def recover(self) -> None:
        """Forget a lost grasp on an operator's word; begin nothing.

        Raises RobotError: anything else is wrong still.
        """
        self._wish_m = self._held_m = None
        if self._reading is None or not self._reading.is_grasped:
            self._last = None
            self._holds = False
        self.tick()

    def _take_reading(self) -> None:
        reading = self._client.read()
        if reading is None:
            return
        widths = (reading.width_m, reading.max_width_m)
        if not all(-THINNEST_m <= width <= WIDEST_m for width in widths):  # NaN is not, either
            came = f"{reading.width_m} of {reading.max_width_m} m"
            do = "Home the hand, then connect again."
            raise RobotError(
                expected("hand", f"widths of 0 to {WIDEST_m} m", came, do), "hand_state"
            )
        if self._holds and reading.is_grasped:
            if self._held_m is None:
                self._held_m = reading.width_m
            if reading.width_m > self._held_m - SLIPPED_m:  # the hand's own word comes late
                self._held_s = reading.time_s
        self._reading = reading

    def _finish(self, succeeded: bool | None) -> None:
        if succeeded is None:
            return
        self._ended_s = self._clock()  # first: another thread may check in between
        self.is_busy = False
        self._succeeded = succeeded or self._interrupted
        self._holds = succeeded and self._last is not None and self._last.force_N > 0
        if not self._succeeded:
            self.failed_commands += 1
            log.warning("hand: %s did not succeed, try %d of %d", self._last, self._tries, TRIES)

    def _begin(self) -> None:
        wish_m = self._wished()
        reading = self._reading
        if wish_m is None or reading is None:
            return
        is_same = (
            self._last is not None and abs(wish_m - self._last.width_m) < self.settings.hysteresis_m
        )
        if is_same and (self._succeeded or self._tries >= TRIES):
            return
        # from the width of a held object: fingers closed on nothing lost it, which opening hides
        from_m = reading.width_m if self._held_m is None else self._held_m
        command = next_command(wish_m, from_m, self._holds, self.settings)
        if command is None:
            return
        end_m = 0.0 if command.force_N > 0 else command.width_m  # a grasp of nothing closes fully
        travel_s = abs(reading.width_m - end_m) / command.speed_m_s
        self._client.begin(command)
        self._deadline_s = self._clock() + travel_s + GRACE_s
        self._tries = self._tries + 1 if is_same else 1
        self._held_m = None
        self._last = command
        self.is_busy = True
        self._holds = self._interrupted = False

    def _wished(self) -> float | None:
        """Return the wished width, no wider than this hand opens."""
        if self._wish_m is None or self._reading is None:
            return None
        return min(self._wish_m, self._reading.max_width_m)

    def _stop_if_due(self) -> None:
        """Stop the fingers on demand, or where they have come as far as is wished now."""
        wanted = self._stop_wanted
        self._stop_wanted = False
        if not self.is_busy or self._interrupted or not (wanted or self._is_there()):
            return
        self._client.stop()
        self._interrupted = True
        self._deadline_s = self._clock() + GRACE_s
        if wanted:
            self._last = None

    def _is_there(self) -> bool:
        """Return whether a command in flight has reached the newest wish, or passed it."""
        wish_m = self._wished()
        reading = self._reading
        command = self._last
        if wish_m is None or reading is None or command is None:
            return False
        if command.force_N > 0:
            return reading.width_m <= wish_m
        # a move ends by itself at its own width
        return wish_m < command.width_m - self.settings.hysteresis_m and reading.width_m >= wish_m
