"""The gripper: one command in flight, never interrupted, its state never waited for.

The real hand answers a command when its fingers have arrived, gives its state about ten times a second and takes an
interruption badly; a control loop at 30 Hz can wait for none of that.
"""

import logging
import time
from collections.abc import Callable

from uniforce_robots.franka.clients import HandClient, HandCommand, HandReading, THINNEST_m
from uniforce_robots.franka.limits import HandSettings
from uniforce_vtla.errors import RobotError, SensorError, expected

log = logging.getLogger(__name__)
GRACE_s = 0.5  # a command may take its travel at the set speed and this much more: the hand begins slowly
LOST_s = 0.3  # three readings without hold, by the hand's own word: what was grasped counts as lost
WIDEST_m = 0.12  # no hand opens so far


def next_command(target_m: float, last: HandCommand | None, settings: HandSettings) -> HandCommand | None:
    """Return the command a target width asks for, None where the last one will do.

    Closing on something by position would press with all the motor has, so what may touch is a grasp.
    """
    if last is not None and abs(target_m - last.width_m) < settings.hysteresis_m:
        return None
    closes = last is None or target_m < last.width_m
    grasps = closes and target_m < settings.grasp_below_m
    return HandCommand(target_m, settings.speed_m_s, settings.grip_force_N if grasps else 0.0)


def require_open(reading: HandReading, open_width_m: float) -> None:
    """Refuse a free-air reference while the fingers may hold something.

    Raises SensorError: they hold something, or are closer than ``open_width_m``.
    """
    if reading.is_grasped or reading.width_m < open_width_m:
        came = "holding something" if reading.is_grasped else f"{reading.width_m * 1000:.0f} mm"
        do = "Open the gripper, then take the references again."
        raise SensorError(expected("free air", f"fingers ≥ {open_width_m * 1000:.0f} mm apart", came, do))


class Hand:
    """What is wanted of a hand, one command at a time: ``start``, ``submit`` widths, ``tick``, read ``reading``.

    No call but ``start`` waits. The arm's stream ticks it, so that what is wrong with the hand stops the arm.
    """

    def __init__(
        self, client: HandClient, settings: HandSettings | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.settings = settings or HandSettings()
        self.failed_grasps = 0
        self._client, self._clock = client, clock
        self._reading: HandReading | None = None
        self._target_m: float | None = None
        self._last: HandCommand | None = None
        self.is_busy = False  # a command is in flight
        self._deadline_s = self._ended_s = 0.0  # of the command in flight; when the last one ended
        self._held_s: float | None = None  # when it last said that it holds something; None: nothing to lose
        self._fault: RobotError | None = None

    def start(self) -> None:
        """Connect and read the hand once; raises RobotError: no connection, or no first reading."""
        self._client.connect()
        self._take_reading()
        if self._reading is None:
            raise RobotError("hand: expected a first reading, got none. Is the hand initialised?", "hand_connection")

    @property
    def reading(self) -> HandReading:
        """The newest reading, whatever its age: while a command runs some clients give none.

        Raises RobotError: the hand has a fault.
        """
        if self._fault is not None:
            raise self._fault
        if self._reading is None:
            raise RobotError("hand: expected start() first, got no reading. Connect the robot.", "ended")
        return self._reading

    def submit(self, width_m: float) -> None:
        """Want a width from now on; the newest one counts once the hand is free.

        Raises RobotError: the hand has a fault; ``guard``: a width that no layer above should have let through.
        """
        if self._fault is not None:
            raise self._fault
        if not -THINNEST_m <= width_m <= WIDEST_m:
            do = "Not sent; please report it."
            raise RobotError(expected("width to send", f"0 to {WIDEST_m} m", width_m, do), "guard")
        self._target_m = width_m

    def tick(self) -> None:
        """Take the newest reading and outcome, begin the next command, and check; one thread at a time.

        Raises RobotError: as ``check``; a fault of the client stays until the robot connects again.
        """
        try:
            self._take_reading()
            if self.is_busy:
                self._finish(self._client.poll())
            else:
                self._begin()
        except RobotError as fault:
            self._fault = self._fault or fault
        self.check()

    def check(self) -> None:
        """Raise what is wrong with the hand now.

        Raises RobotError: the hand's fault; ``hand_connection``: it has hung up; ``hand_deadline``: a command takes too
        long; ``hand_stale``: no new reading; ``grasp_lost``: it let go of what it held without being asked to.
        """
        if self._fault is not None:
            raise self._fault
        self._client.refuse_closed()
        if self.is_busy and self._clock() > self._deadline_s:
            came, do = f"an answer to {self._last}", "Is something in its way? Free it, then connect again."
            raise RobotError(expected("hand", came, "none in time", do), "hand_deadline")
        self._refuse_old()
        held_s, reading = self._held_s, self._reading
        if held_s is not None and reading is not None and reading.time_s - held_s > LOST_s:
            do = "Put it back into the fingers, then call recover()."
            raise RobotError(expected("hand", "what was grasped", "nothing any more", do), "grasp_lost")

    def _refuse_old(self) -> None:
        if self._reading is None or (self.is_busy and not self._client.reads_while_busy):
            return  # the deadline of the command bounds the time without readings
        age_s = self._clock() - max(self._reading.time_s, self._ended_s)
        if age_s > self.settings.reading_age_s:
            wanted = f"a reading younger than {self.settings.reading_age_s} s"
            do = "Check the cable and the robot's controller."
            raise RobotError(expected("hand", wanted, f"{age_s:.2f} s", do), "hand_stale")

    def recover(self) -> None:
        """Forget a lost grasp on an operator's word; raises RobotError: anything else is wrong still."""
        self._held_s = None
        self.tick()

    def _take_reading(self) -> None:
        reading = self._client.read()
        if reading is None:
            return
        widths = (reading.width_m, reading.max_width_m)
        if not all(-THINNEST_m <= width <= WIDEST_m for width in widths):  # NaN is not, either
            came, do = f"{widths[0]} of {widths[1]} m", "Home the hand, then connect again."
            raise RobotError(expected("hand", f"widths of 0 to {WIDEST_m} m", came, do), "hand_state")
        grasps = self._last is not None and self._last.force_N > 0 and not self.is_busy
        if grasps and reading.is_grasped:
            self._held_s = reading.time_s
        self._reading = reading

    def _finish(self, outcome: bool | None) -> None:
        if outcome is None:
            return
        self._ended_s = self._clock()  # first: another thread may check in between
        self.is_busy = False
        if not outcome:
            self.failed_grasps += 1
            log.warning("hand: %s did not succeed", self._last)

    def _begin(self) -> None:
        command = None if self._target_m is None else next_command(self._target_m, self._last, self.settings)
        if command is None or self._reading is None:
            return
        end_m = 0.0 if command.force_N > 0 else command.width_m  # a grasp of nothing closes fully
        travel_s = abs(self._reading.width_m - end_m) / command.speed_m_s
        self._client.begin(command)
        self._deadline_s = self._clock() + travel_s + GRACE_s
        self._held_s, self._last, self.is_busy = None, command, True
