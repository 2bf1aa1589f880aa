"""The one thread that owns the arm: reads it and streams targets to it at 100 Hz, between actions that come at 30 Hz.

A policy's steps become ramps; when actions stop coming the target becomes the measured pose, so that a spring that
pressed lets go; a fault ends the stream and nothing moves until somebody recovers the arm.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from lerobot_robot_uniforce_franka.arm import STOPPED_MODES, Arm, ArmState
from lerobot_robot_uniforce_franka.poses import ToolPose, between
from uniforce_vtla.errors import RobotError, expected

log = logging.getLogger(__name__)
JOIN_s = 10.0  # a backend's own deadlines are shorter
SILENT_AGES = 2  # a robot's clock that stands still for so many of ``state_age_s``: nobody is there
GOOD_RATE = 0.9  # share of commands in time, below which someone should look at the computer


@dataclass(frozen=True)
class StreamSettings:
    """Rhythm of the stream.

    Attributes:
        rate_hz: targets per second.
        action_period_s: how long a ramp to a new action takes; the policy's own period.
        stale_s: an action older than this is no longer followed.
        state_age_s: a reading older than this is not given to anybody; a robot that tells nothing new for twice as
            long is gone.
    """

    rate_hz: float = 100.0
    action_period_s: float = 1 / 30
    stale_s: float = 0.2
    state_age_s: float = 0.2


@dataclass(frozen=True)
class Ramp:
    """A straight way from one pose to another, begun at a time."""

    start: ToolPose
    end: ToolPose
    begun_s: float
    duration_s: float

    def at(self, now_s: float) -> ToolPose:
        """Return the pose at a time; before the start and after the end it rests."""
        share = (now_s - self.begun_s) / self.duration_s if self.duration_s > 0 else 1.0
        return between(self.start, self.end, min(max(share, 0.0), 1.0))


class ArmStream:
    """Own an arm that is connected: ``start``, ``submit`` actions, read ``state``, ``stop``.

    Args:
        arm: a connected backend; nobody else may call it until ``stop`` has returned.
        settings: rhythm.
    """

    def __init__(self, arm: Arm, settings: StreamSettings | None = None) -> None:
        self.settings = settings or StreamSettings()
        self.stale_count = 0  # how often the watchdog took the target away
        self._arm = arm
        self._lock = threading.Lock()
        self._state: ArmState | None = None
        self._ramp: Ramp | None = None
        self._submitted_s = 0.0
        self._robot_time_s = self._advanced_s = 0.0
        self._holding = self._late = False
        self._fault: RobotError | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="arm-stream")

    def start(self) -> None:
        """Read the arm once, so that a state is there, and begin."""
        self._state = self._arm.state()
        self._robot_time_s, self._advanced_s = self._state.robot_time_s, time.monotonic()
        self._thread.start()

    def stop(self) -> None:
        """Let go of the arm and wait for the thread. Safe to call twice; the arm's fault, if any, stays readable."""
        self._ending.set()
        if self._thread.ident is None:
            return
        self._thread.join(JOIN_s)
        if self._thread.is_alive():
            do = "The client hangs; end the process."
            raise RobotError(expected("arm thread", f"an end within {JOIN_s} s", "none", do), "connection")

    @property
    def fault(self) -> RobotError | None:
        """What ended the stream, None while all is well."""
        return self._fault

    @property
    def state(self) -> ArmState:
        """The newest reading. Never blocks.

        Raises:
            RobotError: the arm has a fault, or the reading is older than ``state_age_s``.
        """
        self._check()
        with self._lock:
            state = self._state
        if state is None:
            raise RobotError(
                "arm stream: expected start() first, got no reading. Connect the robot.", "ended"
            )
        age = time.monotonic() - state.time_s
        if age > self.settings.state_age_s:
            wanted = f"a reading younger than {self.settings.state_age_s} s"
            raise RobotError(
                expected("arm state", wanted, f"{age:.2f} s", "Is the computer overloaded?"), "stale"
            )
        return state

    def submit(self, target: ToolPose) -> None:
        """Go to a pose within an action's period. Never blocks.

        Raises:
            RobotError: the arm has a fault, or the stream has ended.
        """
        self._check()
        if self._ending.is_set():
            raise RobotError(
                "arm: expected a running stream, got one that has ended. Connect again.", "ended"
            )
        with self._lock:
            now = time.monotonic()
            start = self._ramp.at(now) if self._ramp else self._measured()
            self._ramp = Ramp(start, target, now, self.settings.action_period_s)
            self._submitted_s, self._holding = now, False

    def hold(self) -> None:
        """Pull towards where the arm is now, at once. Does nothing before the first action or after a fault."""
        with self._lock:
            if self._ramp is not None:
                self._rest_here()

    def _check(self) -> None:
        if self._fault is not None:
            raise self._fault

    def _measured(self) -> ToolPose:
        if self._state is None:
            raise RobotError("arm stream: expected start() first, got an action. Connect the robot.", "ended")
        return ToolPose.from_ee(self._state.ee_to_base)

    def _run(self) -> None:
        """Stream until told to end; whatever ends it, the arm is let go and nothing more is taken."""
        try:
            self._loop()
        except RobotError as fault:
            self._fault = fault
            log.error("arm stopped (%s): %s", fault.fault, fault)
        finally:
            self._ending.set()
            self._let_go()

    def _loop(self) -> None:
        due = time.monotonic()
        # Not a daemon, which would die inside the C++ client: it ends in order when the program does.
        while not self._ending.is_set() and threading.main_thread().is_alive():
            self._tick()
            due = max(due + 1 / self.settings.rate_hz, time.monotonic())
            self._ending.wait(due - time.monotonic())

    def _tick(self) -> None:
        state = self._arm.state()
        self._refuse_silent(state)
        with self._lock:
            self._state = state
        _refuse_stopped(state)
        self._warn_of_late_commands(state)
        target = self._target(time.monotonic())
        if target is not None:
            self._arm.set_target(target.ee_to_base())

    def _refuse_silent(self, state: ArmState) -> None:
        """Notice a robot whose clock stands still; its client does so only after a second."""
        now = time.monotonic()
        if state.robot_time_s != self._robot_time_s:
            self._robot_time_s, self._advanced_s = state.robot_time_s, now
        silent_s = now - self._advanced_s
        if silent_s > SILENT_AGES * self.settings.state_age_s:
            do = "Check the cable and the robot's controller."
            came = f"none for {silent_s:.2f} s"
            raise RobotError(expected("arm", "new states from the robot", came, do), "connection")

    def _warn_of_late_commands(self, state: ArmState) -> None:
        late = state.mode == "move" and state.success_rate < GOOD_RATE
        if late and not self._late:
            log.warning("only %.0f%% of the commands reach the robot in time", 100 * state.success_rate)
        self._late = late

    def _target(self, now_s: float) -> ToolPose | None:
        """Return where to pull now, None before the first action."""
        with self._lock:
            if self._ramp is None:
                return None
            if now_s - self._submitted_s > self.settings.stale_s and not self._holding:
                self._hold_stale()
            return self._ramp.at(now_s)

    def _rest_here(self) -> None:
        here = self._measured()
        self._ramp, self._holding = Ramp(here, here, time.monotonic(), 0.0), True

    def _hold_stale(self) -> None:
        """Take the measured pose as target, once: followed for ever it would let the arm sink under any load."""
        self.stale_count += 1
        self._rest_here()
        log.warning("no action for %.0f ms: holding the measured pose", 1000 * self.settings.stale_s)

    def _let_go(self) -> None:
        try:
            self._arm.stop()
        except RobotError as error:
            log.error("arm did not stop in order: %s", error)
            self._fault = self._fault or error


def _refuse_stopped(state: ArmState) -> None:
    if state.mode in STOPPED_MODES:
        do = "See to the robot, then call recover()."
        raise RobotError(expected("arm mode", "idle or move", state.mode, do), STOPPED_MODES[state.mode])
