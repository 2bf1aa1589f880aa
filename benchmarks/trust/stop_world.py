"""Two robots for sessions, on a set clock or behind the stand-in; and what really moved.

Both run the product's own code from the session down to the last check. ``Watch`` knows nothing of
that code: it is told when a stop and when a new wish came, and looks at where the arm, the hand and
the fingers really are.
"""

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.spatial.transform import Rotation

from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad, posture
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka import robot as robot_module
from uniforce_robots.franka.arm import ArmSetup, ArmState
from uniforce_robots.franka.limits import HandSettings, StreamSettings
from uniforce_robots.franka.stream import ArmStream
from uniforce_robots.standins.fci.process import StandIn
from uniforce_vtla.errors import RobotError
from uniforce_vtla.hand import HandCommand, HandReading

TICK_s = 0.01
BRAKE_s = 0.4  # after a fault or a silence; from then on nothing may move
# After a hold that was ordered: sooner than any watchdog would stop it, so that a hold that does
# nothing is seen.
HOLD_s = 0.1
# The stand-in's arm swings out on its spring, and its clock is slow on a busy computer.
STANDIN_BRAKE_s = 1.0
STILL_m, STILL_rad = 0.001, np.radians(1.0)
# a tilted hand may be sent upright by this much along each metre that it is sent
LEVELS_rad_m = 1.0
ROUNDING_rad = 1e-4
READING_s = 0.1  # between two readings of the hand
# how a person leads the arm by hand, out of its box soon
GUIDED_m_s = np.array([-0.1, 0.05, -0.02])
WIDEST_m = 0.08
# Slow, so that what goes on after a stop goes on for long: an arm that was at its target at once
# would hide it.
ARM_m_s, ARM_rad_s = 0.04, 0.15
FINGERS = HandSettings(speed_m_s=0.02)


class Watch:
    """Compare where the robot is with where it was when a stop was over, until a new wish comes."""

    def __init__(self, brake_s: float = BRAKE_s, hold_s: float = HOLD_s) -> None:
        self._brake_s, self._hold_s = brake_s, hold_s
        self._rests_in_s = brake_s
        self.violations: list[str] = []
        self.moves = 0  # looks at which it had moved since the one before
        self._seen: tuple[np.ndarray, float] | None = None
        self._why = "before the first wish"
        self._since_s: float | None = None  # of the last stop; None: a wish came since
        self._rest: tuple[np.ndarray, float] | None = None

    def stopped(self, why: str, now_s: float, at_once: bool = False) -> None:
        """Note a stop; ``at_once``: somebody ordered it, it needn't be noticed first."""
        self._why, self._since_s, self._rest = why, now_s, None
        self._rests_in_s = self._hold_s if at_once else self._brake_s

    def wished(self) -> None:
        """Note a new wish: the robot may move until the next stop."""
        self._since_s = None

    def sent(self, before: np.ndarray, target: np.ndarray) -> None:
        """Compare two targets in a row, (4, 4): a hand is turned slowly, only on its way."""
        levelled_rad = _tilt_rad(before) - _tilt_rad(target)
        way_m = float(np.linalg.norm(target[:3, 3] - before[:3, 3]))
        if levelled_rad > LEVELS_rad_m * way_m + ROUNDING_rad:
            how = f"{np.degrees(levelled_rad):.2f}° along {1000 * way_m:.2f} mm"
            self.violations.append(f"the hand was sent upright by {how}")

    def look(self, pose: np.ndarray, width_m: float, now_s: float, by_hand: bool) -> None:
        """Take where the hand is, (4, 4), the fingers' width; ``by_hand``: a person moves it."""
        if self._seen is not None:
            seen, seen_m = self._seen
            self.moves += bool(
                np.abs(seen - pose).max() > STILL_m / 10 or abs(seen_m - width_m) > STILL_m / 10
            )
        self._seen = pose.copy(), width_m
        if by_hand:
            self._rest = None
            return
        if self._since_s is None or now_s - self._since_s < self._rests_in_s:
            return
        if self._rest is None:
            self._rest = pose.copy(), width_m
            return
        before, before_m = self._rest
        moved_m = float(np.linalg.norm(pose[:3, 3] - before[:3, 3]))
        turned_rad = float(Rotation.from_matrix(before[:3, :3].T @ pose[:3, :3]).magnitude())
        fingers_m = abs(width_m - before_m)
        if moved_m > STILL_m or turned_rad > STILL_rad or fingers_m > STILL_m:
            turned_deg = np.degrees(turned_rad)
            how = (
                f"hand {1000 * moved_m:.1f} mm {turned_deg:.1f}°, fingers {1000 * fingers_m:.1f} mm"
            )
            after_s = now_s - self._since_s
            self.violations.append(f"{how}, {after_s:.2f} s after: {self._why}")
            self._rest = pose.copy(), width_m


def _tilt_rad(pose: np.ndarray) -> float:
    return float(np.arccos(np.clip(-pose[2, 2], -1.0, 1.0)))


class SimArm:
    """An arm that goes slowly to its target; a person can stop, block, lead and tilt it."""

    def __init__(self, world: "SimWorld") -> None:
        self._world = world
        self.pose = posture(HOME_q_rad).flange_to_base @ HAND_TO_FLANGE
        self.target: np.ndarray | None = None
        self.mode, self.lie = "idle", ""
        self.is_blocked = self.is_pressed = False
        self.setup = ArmSetup(HAND_TO_FLANGE, 0.0)
        self._readings = 0

    def connect(self) -> None:
        """Begin honestly: an arm that was wrong from the start on could not be known to be."""
        self.lie = ""

    def state(self) -> ArmState:
        """Return where it is, or what can't be."""
        now_s, pose = self._world.clock(), self.pose.copy()
        self._readings += 1
        if self.lie == "jump":
            pose[0, 3] += 0.1
        if self.lie == "nan":
            pose[2, 3] = np.nan
        q_rad = np.full(7, 1e-9 * self._readings)  # encoders never read the same twice
        return ArmState(now_s, now_s, q_rad, np.zeros(7), pose, np.zeros(6), self.mode, 1.0)

    def set_target(self, ee_to_base: np.ndarray) -> None:
        """Pull towards a pose from now on."""
        self._world.watch.sent(self.pose if self.target is None else self.target, ee_to_base)
        self.target = ee_to_base.copy()

    def stop(self, at_once: bool = False) -> None:
        """Let go."""
        self.target = None

    close = stop

    def recover(self) -> None:
        """Clear a reflex; raises RobotError: a button is still pressed."""
        if self.is_pressed:
            fault = {"user_stopped": "user_stop"}.get(self.mode, self.mode)
            raise RobotError(f"still {self.mode}", fault)
        self.mode, self.lie = "idle", ""

    def advance(self) -> None:
        """Move for a tick."""
        if self.mode == "guiding":
            self.pose[:3, 3] += GUIDED_m_s * TICK_s
        if self.target is None or self.mode not in ("idle", "move") or self.is_blocked:
            return
        way = self.target[:3, 3] - self.pose[:3, 3]
        reach_m = ARM_m_s * TICK_s
        self.pose[:3, 3] += way * min(1.0, reach_m / max(float(np.linalg.norm(way)), 1e-9))
        turn = Rotation.from_matrix(self.target[:3, :3] @ self.pose[:3, :3].T)
        share = min(1.0, ARM_rad_s * TICK_s / max(float(turn.magnitude()), 1e-9))
        self.pose[:3, :3] = (turn**share).as_matrix() @ self.pose[:3, :3]


class SimHand:
    """Fingers that go at their speed, close on an object, and report ten times a second."""

    def __init__(self, world: "SimWorld") -> None:
        self._world = world
        self.width_m, self.object_m = WIDEST_m, 0.0
        self.is_grasped = False
        self._command: HandCommand | None = None
        self._outcome: bool | None = None
        self._reading = HandReading(world.clock(), self.width_m, WIDEST_m, False)

    def connect(self) -> None:
        """Do nothing."""

    refuse_closed = connect

    def begin(self, command: HandCommand) -> None:
        """Begin a command."""
        self._command, self._outcome, self.is_grasped = command, None, False

    def stop(self) -> None:
        """Stop where the fingers are."""
        if self._command is not None:
            self._command, self._outcome = None, False

    close = stop

    def poll(self) -> bool | None:
        """Return how the command ended, None while it runs."""
        outcome, self._outcome = self._outcome, None
        return outcome

    def read(self) -> HandReading:
        """Return the newest reading."""
        return self._reading

    def advance(self) -> None:
        """Move for a tick."""
        now_s = self._world.clock()
        if now_s - self._reading.time_s >= READING_s - 1e-9:
            self._reading = HandReading(now_s, self.width_m, WIDEST_m, self.is_grasped)
        command = self._command
        if command is None:
            return
        goal_m = 0.0 if command.force_N > 0 else command.width_m
        if self.width_m >= self.object_m:
            goal_m = max(goal_m, self.object_m)
        step_m = command.speed_m_s * TICK_s
        self.width_m += float(np.clip(goal_m - self.width_m, -step_m, step_m))
        if abs(self.width_m - goal_m) < 1e-9:
            touches = 0 < self.object_m == goal_m
            self._command = None
            self.is_grasped = command.force_N > 0 and touches
            self._outcome = self.is_grasped if command.force_N > 0 else goal_m == command.width_m


class TickedStream(ArmStream):
    """A stream whose thread is the world's clock."""

    def start(self) -> None:
        """Read the arm once."""
        self.read_first()
        self.is_over = False

    def advance(self) -> None:
        """Tick once, or end as the thread does."""
        if not self._ending.is_set():
            try:
                self.tick()
            except RobotError as fault:
                self.halt(self.fault or fault)
        if self._ending.is_set() and not self.is_over:
            self.is_over = True
            self._let_go()

    def stop(self) -> None:
        """End, and let go of the arm."""
        self._ending.set()
        self.advance()


class SimWorld:
    """A robot on a clock that is set, with the faults a person or an arm may bring."""

    paced = False
    orders = (
        "reflex",
        "user_stop",
        "guide",
        "release",
        "jump",
        "nan",
        "honest",
        "block",
        "unblock",
    )

    def __init__(self) -> None:
        self.now_s = 100.0
        self.watch = Watch()
        self.arm, self.hand = SimArm(self), SimHand(self)
        self._ending = ExitStack()
        folder = self._ending.enter_context(tempfile.TemporaryDirectory())
        # module attributes, since the robot finds its backend and stream there
        backend = mock.patch.object(
            robot_module, "make_backend", lambda config: (self.arm, self.hand)
        )
        self._ending.enter_context(backend)
        self._ending.enter_context(mock.patch.object(robot_module, "ArmStream", TickedStream))
        config = UniforceFrankaConfig(id="sessions", calibration_dir=Path(folder), gripper=FINGERS)
        self.robot = UniforceFranka(config, self.clock)

    def clock(self) -> float:
        """Return the time, s."""
        return self.now_s

    def sleep(self, for_s: float) -> None:
        """Let time pass."""
        for _ in range(round(for_s / TICK_s)):
            self.now_s += TICK_s
            stream = self.robot._stream
            if isinstance(stream, TickedStream):
                stream.advance()
            self.arm.advance()
            self.hand.advance()
            self.look()

    def look(self) -> None:
        """Show the watch where the robot is."""
        self.watch.look(
            self.arm.pose, self.hand.width_m, self.now_s, by_hand=self.arm.mode == "guiding"
        )

    def order(self, what: str) -> None:
        """Do to the robot what a person or a fault does."""
        match what:
            case "reflex":
                self.arm.mode = "reflex"
            case "user_stop" | "guide":
                self.arm.mode = {"user_stop": "user_stopped", "guide": "guiding"}[what]
                self.arm.is_pressed = True
            case "release":
                self.arm.is_pressed = False
                self.arm.mode = "idle" if self.arm.mode != "reflex" else "reflex"
            case "jump" | "nan":
                self.arm.lie = what
            case "honest":
                self.arm.lie = ""
            case "block" | "unblock":
                self.arm.is_blocked = what == "block"

    def tilt(self, by_rad: float) -> None:
        """Tilt the hand as a person who leads it does."""
        self.arm.pose[:3, :3] = (
            Rotation.from_rotvec([by_rad, 0, 0]).as_matrix() @ self.arm.pose[:3, :3]
        )

    def hold_object(self, width_m: float) -> None:
        """Put something of this width where the fingers close; not into closed ones."""
        if width_m < self.hand.width_m:
            self.hand.object_m = width_m

    def close(self) -> None:
        """Disconnect the robot."""
        self.robot.disconnect()
        self._ending.close()


class StandInWorld:
    """A robot behind the stand-in, in real time."""

    paced = True
    orders = ("reflex", "user_stop", "guide", "release")

    def __init__(self, address: str) -> None:
        self.watch = Watch(STANDIN_BRAKE_s, STANDIN_BRAKE_s)
        self.fci = StandIn(address)
        self._folder = tempfile.TemporaryDirectory()
        self._is_led = False
        # a busy machine is late; how late it may be is not the question here
        patient = StreamSettings(state_age_s=1.0)
        config = UniforceFrankaConfig(
            id="sessions",
            calibration_dir=Path(self._folder.name),
            address=address,
            stream=patient,
            gripper=FINGERS,
            connect_deadline_s=30.0,
        )
        self.robot = UniforceFranka(config)
        self.clock, self._sleep = time.monotonic, time.sleep

    def sleep(self, for_s: float) -> None:
        """Wait, and look now and then."""
        end_s = self.clock() + for_s
        while (left_s := end_s - self.clock()) > 0:
            self._sleep(min(left_s, READING_s))
            self.look()

    def look(self) -> None:
        """Show the watch where the robot really is."""
        shown = self.fci.do("look")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = shown["arm"]["rotation"], shown["arm"]["position_m"]
        self.watch.look(pose, shown["hand"]["width_m"], self.clock(), self._is_led)

    def order(self, what: str) -> None:
        """Do to the robot what a person or a fault does; leading it pushes it sideways."""
        self._is_led = what == "guide"
        self.fci.do(what)
        self.fci.do("wrench", newtons=[4.0 * self._is_led, 0, 0, 0, 0, 0])

    def tilt(self, by_rad: float) -> None:
        """Leave the hand as it is: the stand-in is led by its joints."""

    def hold_object(self, width_m: float) -> None:
        """Put something of this width where the fingers close."""
        if width_m < self.fci.do("look")["hand"]["width_m"]:
            self.fci.do("object", width_m=width_m)

    def close(self) -> None:
        """Disconnect the robot and end the stand-in."""
        self.robot.disconnect()
        self.fci.close()
        self._folder.cleanup()


World = SimWorld | StandInWorld


@contextmanager
def connected(world: World) -> Iterator[World]:
    """Connect the world's robot; let go of both at the end."""
    try:
        world.watch.stopped("connecting", world.clock())
        world.robot.connect()
        yield world
    finally:
        world.close()
