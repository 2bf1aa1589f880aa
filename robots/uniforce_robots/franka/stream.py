"""The one thread that owns the arm: it reads the arm and streams targets to it at 100 Hz.

Actions at 30 Hz become ramps. When they stop coming, the target becomes the measured pose, so that
a pressing spring lets go. A fault ends the stream, and nothing moves until the arm is recovered.
Whatever stops the arm stops the hand with it. Each reading is checked before it is used, and each
pose before it is sent.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uniforce_robots.franka.arm import FAULTS_OF_READINGS, ArmState, refuse_stopped
from uniforce_robots.franka.clients import Arm
from uniforce_robots.franka.guards import GuardLimits, towards, turn_towards
from uniforce_robots.franka.limits import StreamSettings
from uniforce_robots.franka.poses import ToolPose, between
from uniforce_robots.franka.state_check import SendCheck, StateCheck, require_upright
from uniforce_vtla.errors import RobotError, expected
from uniforce_vtla.hand import Hand

log = logging.getLogger(__name__)
JOIN_s = 10.0  # a backend's own deadlines are shorter
# a tilted hand turns upright by so much along each metre of a wished way, and never without one
LEVEL_rad_m = 1.0
TOLD_rad = 0.02  # a smaller tilt is not worth a line in the log
GOOD_RATE = 0.9  # share of commands in time, below which someone should look at the computer


@dataclass(frozen=True)
class Ramp:
    """A straight way from one pose to another; before and after it the pose rests."""

    start: ToolPose
    end: ToolPose
    begun_s: float
    duration_s: float

    def at(self, now_s: float) -> ToolPose:
        """Return the pose at a time."""
        share = (now_s - self.begun_s) / self.duration_s if self.duration_s > 0 else 1.0
        return between(self.start, self.end, min(max(share, 0.0), 1.0))


class ArmStream:
    """Own an arm that is connected: ``start``, ``submit`` actions, read ``state``, ``stop``.

    Args:
        arm: a connected backend; no other thread may call it until ``stop`` has returned.
        settings: rhythm.
        limits: what is sent obeys them, whatever was submitted.
        hand: ticked and stopped with the arm; its faults end the stream. None: no hand.
        clock: seconds, monotonic, the one that stamps the arm's readings.
    """

    def __init__(
        self,
        arm: Arm,
        settings: StreamSettings | None = None,
        limits: GuardLimits | None = None,
        hand: Hand | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.settings = settings or StreamSettings()
        self.stale_count = 0  # how often the watchdog took the target away
        self._limits = limits or GuardLimits()
        self._arm = arm
        self._hand = hand
        self._clock = clock
        self._check_state = StateCheck()
        self._check_sent = SendCheck(self._limits)
        self._lock = threading.Lock()
        self._state: ArmState | None = None
        self._ramp: Ramp | None = None
        self._sent: ToolPose | None = None
        self._sent_s = self._submitted_s = 0.0
        self._robot_time_s = self._advanced_s = 0.0
        self._read_s = 0.0  # when the client gave the last reading, be it an old one
        self._hold_ordered = self._holding = self._late = False
        self.fault: RobotError | None = None  # what ended the stream
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="arm-stream")

    def start(self) -> None:
        """Read the arm once, so that a state is there, and begin.

        Raises RobotError: no reading, an impossible one, or a hand not pointing down (``tilt``).
        """
        self.read_first()
        self._thread.start()

    def read_first(self) -> None:
        """Read the arm once without starting the thread; raises as ``start``."""
        state = self._arm.state()
        self._check_state(state)
        require_upright(state, self._limits.tilt_rad)
        self._state = state
        tilt_rad = float(np.linalg.norm(self._measured().tilt_rad))
        if tilt_rad > TOLD_rad:
            way_m = tilt_rad / LEVEL_rad_m
            log.warning(
                "hand tilted by %.0f°: levelled along its first %.2f m", np.degrees(tilt_rad), way_m
            )
        self._robot_time_s = state.robot_time_s
        self._advanced_s = self._clock()

    def stop(self) -> None:
        """Let go of the arm and wait for the thread. Safe to call twice; ``fault`` stays."""
        self._ending.set()
        if self._thread.ident is None:
            return
        self._thread.join(JOIN_s)
        if self._thread.is_alive():
            do = "The client hangs; end the process."
            raise RobotError(
                expected("arm thread", f"an end within {JOIN_s} s", "none", do), "connection"
            )

    def halt(self, fault: RobotError) -> None:
        """End the stream for a reason; the thread lets go of the arm by itself. Never blocks."""
        self.fault = self.fault or fault
        self._ending.set()

    @property
    def state(self) -> ArmState:
        """The newest reading. Never blocks.

        Raises RobotError: the arm has a fault, or the reading is older than ``state_age_s``.
        """
        self._check()
        with self._lock:
            state = self._read_before()
        now_s = self._clock()
        limit_s = self.settings.state_age_s
        age_s = now_s - state.time_s
        if age_s <= limit_s:
            return state
        if now_s - self._read_s < age_s / 2:  # the client answers with what it said before
            raise _silent(age_s)
        wanted = f"a reading younger than {limit_s} s"
        do = "Is the computer overloaded?"
        raise RobotError(expected("arm state", wanted, f"{age_s:.2f} s", do), "stale")

    def _read_before(self) -> ArmState:
        if self._state is None:
            raise RobotError(
                "arm stream: expected start() first, got no reading. Connect the robot.", "ended"
            )
        return self._state

    def submit(self, target: ToolPose) -> None:
        """Go to a pose within an action's period. Never blocks.

        Raises RobotError: the arm has a fault, or the stream has ended.
        """
        self._check()
        if self._ending.is_set():
            raise RobotError(
                "arm: expected a running stream, got one that has ended. Connect again.", "ended"
            )
        with self._lock:
            now = self._clock()
            self._ramp = Ramp(
                self._sent or self._measured(), target, now, self.settings.action_period_s
            )
            self._submitted_s, self._hold_ordered, self._holding = now, False, False

    def hold(self) -> None:
        """Pull towards where the arm is and stop the hand, from the next tick on."""
        self._hold_ordered = True
        if self._hand is not None:
            self._hand.stop()

    @property
    def resting(self) -> ToolPose | None:
        """Where a hold or the watchdog keeps the arm; None before and while it follows actions."""
        ramp = self._ramp
        if ramp is not None and self._holding:
            return ramp.end
        return None

    def _check(self) -> None:
        if self.fault is not None:
            raise self.fault

    def _measured(self) -> ToolPose:
        return ToolPose.from_ee(self._read_before().ee_to_base)

    def _run(self) -> None:
        """Stream until asked to end; then let go of the arm, whatever ended it."""
        due = time.monotonic()
        try:
            # no daemon, which would leave the arm pulling: it ends in order when the program does
            while not self._ending.is_set() and threading.main_thread().is_alive():
                self.tick()
                due = max(due + 1 / self.settings.rate_hz, time.monotonic())
                self._ending.wait(due - time.monotonic())
        # the thread's outermost frame: the caller must learn why it ended
        except Exception as error:
            text = f"arm stream: {type(error).__name__}: {error}. Please report it."
            self.fault = self.fault or (
                error if isinstance(error, RobotError) else RobotError(text, "other")
            )
            log.error("arm stopped (%s): %s", self.fault.fault, self.fault)
        finally:
            self._ending.set()
            self._let_go()

    def tick(self) -> None:
        """Read, check, and send the next pose; what the thread does at ``rate_hz``.

        Raises RobotError: nothing may be sent any more.
        """
        state = self._read()
        if self._hand is not None:
            self._hand.tick()
        with self._lock:
            self._state = state
            target = self._advance(self._clock())
        if target is not None:
            self._send(target, state)

    def _read(self) -> ArmState:
        """Return a reading that can be believed, of an arm that may move."""
        state = self._arm.state()
        self._read_s = self._clock()
        self._check_state(state)
        self._refuse_silent(state)
        refuse_stopped(state)
        require_upright(state, self._limits.tilt_rad)
        self._warn_of_late_commands(state)
        return state

    def _send(self, target: ToolPose, state: ArmState) -> None:
        now = self._clock()
        self._check_sent(target, ToolPose.from_ee(state.ee_to_base), now)
        self._check_state.follows(target.position_m)
        self._sent, self._sent_s = target, now
        try:
            self._arm.set_target(target.ee_to_base())
        except RobotError:
            self._read()  # a reading that is wrong is the better reason
            raise

    def _refuse_silent(self, state: ArmState) -> None:
        """Notice a robot whose clock stands still; its client does so only after a second."""
        now = self._clock()
        if state.robot_time_s != self._robot_time_s:
            self._robot_time_s = state.robot_time_s
            self._advanced_s = now
        if now - self._advanced_s > self.settings.state_age_s:
            raise _silent(now - self._advanced_s)

    def _warn_of_late_commands(self, state: ArmState) -> None:
        late = state.mode == "move" and state.success_rate < GOOD_RATE
        if late and not self._late:
            log.warning(
                "only %.0f%% of the commands reach the robot in time", 100 * state.success_rate
            )
        self._late = late

    def _advance(self, now_s: float) -> ToolPose | None:
        """Hold where that is due; return where to pull now, None before the first action.

        The lock is held.
        """
        if self._ramp is None:
            return None
        if not self._holding and now_s - self._submitted_s > self.settings.stale_s:
            self.stale_count += 1
            self.hold()
            log.warning(
                "no action for %.0f ms: holding the measured pose", 1000 * self.settings.stale_s
            )
        if self._hold_ordered:
            self._rest_here(now_s)
        goal = self._ramp.at(now_s)
        return goal if self._holding else self._slowed(goal, now_s)

    def _slowed(self, goal: ToolPose, now_s: float) -> ToolPose:
        """Return the goal, or as far towards it as speed × time allows: no jump after a delay."""
        if self._sent is None:
            return self._measured()
        limits = self._limits
        elapsed_s = min(now_s - self._sent_s, limits.longest_gap_s)
        position_m = towards(self._sent.position_m, goal.position_m, limits.speed_m_s * elapsed_s)
        yaw_rad = turn_towards(self._sent.yaw_rad, goal.yaw_rad, limits.speed_rad_s * elapsed_s)
        way_m = float(np.linalg.norm(position_m - self._sent.position_m))
        return ToolPose(
            position_m, yaw_rad, towards(self._sent.tilt_rad, np.zeros(3), LEVEL_rad_m * way_m)
        )

    def _rest_here(self, now_s: float) -> None:
        """Take the measured pose as target, once: following it would let the arm sink."""
        here = self._measured()
        self._ramp = Ramp(here, here, now_s, 0.0)
        self._hold_ordered, self._holding = False, True

    def _let_go(self) -> None:
        unbelieved = self.fault is not None and self.fault.fault in FAULTS_OF_READINGS
        if self._hand is not None:
            self._stop_one("hand", self._hand.halt)  # first: it waits for nothing
        self._stop_one("arm", lambda: self._arm.stop(at_once=unbelieved))

    def _stop_one(self, what: str, stop: Callable[[], None]) -> None:
        try:
            stop()
        # the last two of a pipe that another thread closed: the other one must stop all the same
        except (RobotError, OSError, ValueError) as error:
            log.error("%s did not stop in order: %s", what, error)
            fault = error if isinstance(error, RobotError) else RobotError(str(error), "connection")
            self.fault = self.fault or fault


def _silent(for_s: float) -> RobotError:
    came = f"none for {for_s:.2f} s"
    do = "Check the cable and the robot's controller."
    return RobotError(expected("arm", "new states from the robot", came, do), "connection")
