"""The gripper, owned by a thread: one command in flight, never interrupted, its state never waited for.

The real hand answers a command when its fingers have arrived, tells its state about ten times a second and takes an
interruption badly; a control loop at 30 Hz can wait for none of that.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Protocol

from uniforce_vtla.errors import RobotError, SensorError, expected

log = logging.getLogger(__name__)
POLL_s = 0.01
THINNEST_m = 0.002  # of what may be grasped; fingers closer than this hold nothing
OUTER_m = 0.08  # outer tolerance of a grasp: the tool may be thicker than the target, on purpose
JOIN_s = 8.0  # the longest grasp, and the reading after it


@dataclass(frozen=True)
class HandCommand:
    """What to ask of the hand: a grasp where ``force_N`` > 0, a plain move where it is 0."""

    width_m: float
    speed_m_s: float
    force_N: float = 0.0

    @property
    def grasp_width_m(self) -> float:
        """Width to name in a grasp: wide enough that fingers closed on nothing lie outside the tolerance."""
        return max(self.width_m, 2 * THINNEST_m)

    @property
    def inner_m(self) -> float:
        """Inner tolerance of a grasp: anything thicker than ``THINNEST_m`` counts as held."""
        return self.grasp_width_m - THINNEST_m


@dataclass(frozen=True)
class HandReading:
    """What the hand said: opening between the fingers, whether it holds something, host clock at receipt."""

    time_s: float
    width_m: float
    max_width_m: float
    is_grasped: bool


class HandDriver(Protocol):
    """A gripper's client, called by one thread. Every method may raise RobotError."""

    def connect(self) -> None:
        """Open the connection."""

    def begin(self, command: HandCommand) -> None:
        """Start a command; none is in flight."""

    def poll(self) -> bool | None:
        """Return how the command in flight ended (False: nothing grasped), None while it runs."""

    def read(self) -> HandReading | None:
        """Return a new reading, which may take a tenth of a second, or None when there is none now."""

    def stop(self) -> None:
        """Stop the fingers where they are."""

    def close(self) -> None:
        """Hang up. Safe to call twice."""


@dataclass(frozen=True)
class HandSettings:
    """How widths become commands.

    Attributes:
        speed_m_s: of the fingers.
        grip_force_N: of a grasp. Gels and domes are rated for about 11 N; the real hand's smallest force is unverified.
        grasp_below_m: a closing target below this is a grasp (force-bound), above it a move (position).
        hysteresis_m: a smaller change of the target is no new command.
    """

    speed_m_s: float = 0.05
    grip_force_N: float = 10.0
    grasp_below_m: float = 0.04
    hysteresis_m: float = 0.003


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

    Raises:
        SensorError: they hold something, or are closer than ``open_width_m``.
    """
    if reading.is_grasped or reading.width_m < open_width_m:
        came = "holding something" if reading.is_grasped else f"{reading.width_m * 1000:.0f} mm"
        do = "Open the gripper, then take the references again."
        raise SensorError(expected("free air", f"fingers ≥ {open_width_m * 1000:.0f} mm apart", came, do))


class HandThread:
    """Own a hand: ``start``, ``submit`` widths, read ``reading``, ``stop``."""

    def __init__(self, driver: HandDriver, settings: HandSettings | None = None) -> None:
        self.settings = settings or HandSettings()
        self.failed_grasps = 0
        self._driver = driver
        self._lock = threading.Lock()
        self._reading: HandReading | None = None
        self._target_m: float | None = None
        self._last: HandCommand | None = None
        self._in_flight = False
        self._fault: RobotError | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="hand")

    def start(self) -> None:
        """Connect, read the hand once, and begin.

        Raises:
            RobotError: no connection, or no first reading.
        """
        self._driver.connect()
        self._reading = self._driver.read()
        if self._reading is None:
            raise RobotError(
                "hand: expected a first reading, got none. Is the hand initialised?", "connection"
            )
        self._thread.start()

    def stop(self) -> None:
        """Stop the fingers, wait for the thread, hang up. Safe to call twice."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join(JOIN_s)
        if self._thread.is_alive():
            do = "The client hangs; end the process."
            raise RobotError(expected("hand thread", f"an end within {JOIN_s} s", "none", do), "connection")
        self._driver.close()

    @property
    def fault(self) -> RobotError | None:
        """What ended the thread, None while all is well."""
        return self._fault

    @property
    def reading(self) -> HandReading:
        """The newest reading, whatever its age: while a command runs some clients give none. Never blocks.

        Raises:
            RobotError: the hand has a fault.
        """
        if self._fault is not None:
            raise self._fault
        with self._lock:
            reading = self._reading
        if reading is None:
            raise RobotError("hand: expected start() first, got no reading. Connect the robot.", "ended")
        return reading

    @property
    def is_busy(self) -> bool:
        """Whether a command is in flight."""
        return self._in_flight

    def submit(self, width_m: float) -> None:
        """Want a width from now on; the newest one counts once the hand is free. Never blocks.

        Raises:
            RobotError: the hand has a fault.
        """
        if self._fault is not None:
            raise self._fault
        if self._ending.is_set():
            raise RobotError(
                "hand: expected a running thread, got one that has ended. Connect again.", "ended"
            )
        with self._lock:
            self._target_m = width_m

    def _run(self) -> None:
        try:
            while not self._ending.wait(POLL_s) and threading.main_thread().is_alive():
                self._tick()
            if self._in_flight:
                self._driver.stop()
        except RobotError as fault:
            self._fault = fault
            log.error("hand stopped (%s): %s", fault.fault, fault)
        finally:
            self._ending.set()

    def _tick(self) -> None:
        reading = self._driver.read()
        if reading is not None:
            with self._lock:
                self._reading = reading
        if self._in_flight:
            self._finish(self._driver.poll())
        else:
            self._begin()

    def _finish(self, outcome: bool | None) -> None:
        if outcome is None:
            return
        self._in_flight = False
        if not outcome:
            self.failed_grasps += 1
            log.warning("hand: %s did not succeed", self._last)

    def _begin(self) -> None:
        with self._lock:
            target = self._target_m
        command = None if target is None else next_command(target, self._last, self.settings)
        if command is not None:
            self._driver.begin(command)
            self._last, self._in_flight = command, True
