"""Drive the robot's whole chain, from ``send_action`` to the pose on the wire, with random limits, states and actions.

The invariant is written here a second time, without the code it judges: a pose that reaches the arm is finite, inside
the box or not further out than the last one or the arm, one small step from the last one or where the arm is, and near
it.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_uniforce_franka import UniforceFranka, UniforceFrankaConfig
from lerobot_robot_uniforce_franka import robot as robot_module
from lerobot_robot_uniforce_franka.arm import ArmState, Gains
from lerobot_robot_uniforce_franka.guards import GuardLimits
from lerobot_robot_uniforce_franka.hand import HandReading
from lerobot_robot_uniforce_franka.poses import ToolPose
from lerobot_robot_uniforce_franka.stream import ArmStream, StreamSettings
from uniforce_vtla.errors import RobotError
from uniforce_vtla.keys import AXES

STEPS = 50  # actions in an episode
MOTIONS = ("follows", "lags", "blocked", "pushed", "jumps", "no_numbers", "stops")
GARBAGE: tuple[Any, ...] = (None, "0.4", "nan", [], [1.0, 2.0], {}, True, b"0", object())


class Clock:
    """A clock that is set."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        """Return the time, s."""
        return self.now_s


@dataclass
class ScriptedArm:
    """Moves as its name says; keeps each target and where it was then."""

    clock: Clock
    rng: np.random.Generator
    pose: ToolPose
    motion: str = "follows"
    sent: list[tuple[float, ToolPose, ToolPose]] = field(default_factory=list)

    def connect(self) -> None:
        """Do nothing."""

    def state(self) -> ArmState:
        """Return where it is; now and then something impossible."""
        pose, mode = self.pose.ee_to_base(), "move"
        rarely = self.rng.random() < 0.005
        if rarely and self.motion == "no_numbers":
            pose[self.rng.integers(4), self.rng.integers(4)] = self.rng.choice([np.nan, np.inf])
        if rarely and self.motion == "jumps":
            self.pose = _moved(self.pose, self.rng.normal(0, 0.2, 4))
            pose = self.pose.ee_to_base()
        if rarely and self.motion == "stops":
            mode = str(self.rng.choice(["reflex", "user_stopped", "guiding"]))
        now = self.clock()
        q = self.rng.normal(0, 1e-6, 7)
        return ArmState(now, now, q, np.zeros(7), pose, np.zeros(6), mode, 1.0)

    def set_target(self, ee_to_base: np.ndarray) -> None:
        """Keep the target and move."""
        target = ToolPose.from_ee(ee_to_base)
        self.sent.append((self.clock(), target, self.pose))
        share = {"follows": 1.0, "lags": 0.3, "blocked": 0.0}.get(self.motion, 0.5)
        step = share * (_axes(target) - _axes(self.pose))
        step[3] = share * _turn(_axes(self.pose)[3], _axes(target)[3])
        if self.motion == "pushed":
            step += self.rng.normal(0, 0.003, 4)
        limit = 0.01 / max(float(np.linalg.norm(step[:3])), 0.01)  # no faster than an arm can be
        self.pose = _moved(self.pose, step * [limit, limit, limit, min(1.0, limit)])

    def set_gains(self, gains: Gains) -> None:
        """Do nothing."""

    def stop(self, at_once: bool = False) -> None:
        """Do nothing."""

    def recover(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class StillHand:
    """A hand that is well."""

    fault = None

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.widths_m: list[float] = []

    def check(self) -> None:
        """Nothing is wrong."""

    recover = check

    @property
    def reading(self) -> HandReading:
        """Open."""
        return HandReading(self._clock(), 0.08, 0.08, False)

    def submit(self, width_m: float) -> None:
        """Keep the width."""
        self.widths_m.append(width_m)


def random_limits(rng: np.random.Generator) -> GuardLimits:
    """Return valid limits, from narrow to the hard ones."""
    centre, half = (
        rng.uniform([0.3, -0.3, 0.1, -1, 0.03], [0.6, 0.3, 0.4, 1, 0.05]),
        rng.uniform(0.01, 0.03, 5),
    )
    half[:4] *= rng.uniform(1, 8)
    steps = {"step_m": 0.1, "step_rad": 0.8, "speed_m_s": 0.5, "speed_rad_s": 2.5, "speed_width_m_s": 0.2}
    drawn = {name: float(high * rng.uniform(0.01, 1)) for name, high in steps.items()}
    low, high = centre - half, centre + half
    return GuardLimits(
        tuple(low.tolist()), tuple(high.tolist()), **drawn, longest_gap_s=rng.uniform(0.01, 0.2)
    )


def random_action(rng: np.random.Generator, here: ToolPose) -> dict[str, Any]:
    """Return an action: near, far, absurd or no action at all."""
    near = np.array([*_axes(here), 0.05])
    kind = rng.choice(["near", "far", "absurd", "broken"], p=[0.63, 0.33, 0.03, 0.01])
    scale = {"near": 0.01, "far": 0.5, "absurd": 1e9}.get(kind, 0.0)
    action: dict[str, Any] = dict(zip(AXES, (near + scale * rng.normal(0, 1, 5)).tolist(), strict=True))
    if kind == "broken":
        axis = str(rng.choice(AXES))
        choice = rng.integers(len(GARBAGE) + 3)
        if choice == 0:
            del action[axis]
        elif choice <= 2:
            action[axis] = float(rng.choice([np.nan, np.inf, -np.inf]))
        else:
            action[axis] = GARBAGE[choice - 3]
    return action


def drive(episodes: int, seed: int = 0) -> dict[str, Any]:
    """Run episodes of ``STEPS`` actions; return how many actions, poses and faults there were, and each violation."""
    rng = np.random.default_rng(seed)
    counts: dict[str, Any] = {"actions": 0, "sent": 0, "violations": []}
    faults: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(episodes):
            _episode(rng, Path(folder), counts, faults)
    return counts | {"faults": dict(sorted(faults.items()))}


def _episode(rng: np.random.Generator, folder: Path, counts: dict[str, Any], faults: dict[str, int]) -> None:
    limits, clock = random_limits(rng), Clock()
    start = rng.uniform(limits.low, limits.high)[:4] + rng.normal(0, 0.02, 4) * (rng.random() < 0.3)
    arm = ScriptedArm(clock, rng, ToolPose(start[:3], float(start[3])), str(rng.choice(MOTIONS)))
    robot, stream, hand = _robot(folder, limits, clock, arm)
    try:
        stream.read_first()
    except RobotError:  # the first reading was impossible: it never starts
        return
    for _ in range(STEPS):
        fault = _act(rng, robot, stream, clock, arm)
        counts["actions"] += 1
        if fault is not None:
            faults[fault.fault] = faults.get(fault.fault, 0) + 1
            counts["violations"] += _goes_on(rng, robot, stream, arm)
            break
    counts["sent"] += len(arm.sent)
    counts["violations"] += violations(limits, arm.sent)
    spread = (
        np.array([0.08, *hand.widths_m]) - limits.low[4],
        limits.high[4] - np.array([0.08, *hand.widths_m]),
    )
    outside = np.minimum(*spread)[1:]
    counts["violations"] += [f"width {w}" for w in outside if not np.isfinite(w)]


def _robot(
    folder: Path, limits: GuardLimits, clock: Clock, arm: ScriptedArm
) -> tuple[UniforceFranka, ArmStream, StillHand]:
    hand = StillHand(clock)
    make, robot_module.make_backend = robot_module.make_backend, lambda config: (arm, hand)  # type: ignore[assignment]
    try:
        robot = UniforceFranka(UniforceFrankaConfig(id="cases", calibration_dir=folder, guards=limits), clock)
    finally:
        robot_module.make_backend = make
    stream = ArmStream(arm, StreamSettings(), limits, hand.check, clock)
    robot._stream, robot._hand = stream, hand  # type: ignore[assignment]  no thread: the cases tick it themselves
    return robot, stream, hand


def _act(
    rng: np.random.Generator, robot: UniforceFranka, stream: ArmStream, clock: Clock, arm: ScriptedArm
) -> RobotError | None:
    """Send one action and let the stream tick a few times; the clock may stand still or leap."""
    try:
        if rng.random() < 0.9:
            robot.send_action(random_action(rng, arm.pose))
        for _ in range(rng.integers(1, 5)):
            clock.now_s += float(rng.choice([0.0, 0.001, 0.01, 0.03, 0.15], p=[0.05, 0.1, 0.6, 0.2, 0.05]))
            stream.tick()
    except RobotError as fault:
        stream.halt(fault)
        return fault
    return None


def _goes_on(
    rng: np.random.Generator, robot: UniforceFranka, stream: ArmStream, arm: ScriptedArm
) -> list[str]:
    """Return what is wrong after a fault: a good action must be refused, and nothing sent."""
    count = len(arm.sent)
    try:
        robot.send_action(dict(zip(AXES, [*_axes(arm.pose), 0.05], strict=True)))
    except RobotError:
        return [] if len(arm.sent) == count else ["a pose was sent after a fault"]
    return ["an action was taken after a fault"]


def violations(limits: GuardLimits, sent: list[tuple[float, ToolPose, ToolPose]]) -> list[str]:
    """Return what is wrong with a sequence of (time s, pose sent, where the arm was)."""
    found, last, last_s = [], None, 0.0
    low, high = np.array(limits.low[:4]), np.array(limits.high[:4])
    for now_s, target, measured in sent:
        pose, here = _axes(target), _axes(measured)
        before = here if last is None else last
        elapsed_s = limits.longest_gap_s if last is None else min(now_s - last_s, limits.longest_gap_s)
        lowest, highest = (
            np.minimum(low, np.minimum(before, here)),
            np.maximum(high, np.maximum(before, here)),
        )
        at_arm = _gap(pose, here) <= 1.1e-3 and abs(_turn(pose[3], here[3])) <= 1.1e-2
        slow = _gap(pose, before) <= limits.speed_m_s * elapsed_s + 1e-5
        slow &= abs(_turn(pose[3], before[3])) <= limits.speed_rad_s * elapsed_s + 1e-5
        near = _gap(pose, here) <= limits.step_m + limits.speed_m_s * limits.longest_gap_s + 1e-5
        checks = {
            "finite": bool(np.isfinite(pose).all()),
            "box": bool(((pose >= lowest - 1e-5) & (pose <= highest + 1e-5)).all()),
            "rate": bool(slow or at_arm),
            "near": bool(near),
        }
        found += [
            f"{name} at {now_s:.3f} s: {pose.round(4).tolist()}" for name, good in checks.items() if not good
        ]
        last, last_s = pose, now_s
    return found


def _axes(pose: ToolPose) -> np.ndarray:
    return np.array([*pose.position_m, pose.yaw_rad])


def _moved(pose: ToolPose, step: np.ndarray) -> ToolPose:
    return ToolPose(pose.position_m + step[:3], float(pose.yaw_rad + step[3]))


def _gap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a[:3] - b[:3]))


def _turn(start_rad: float, end_rad: float) -> float:
    return float((end_rad - start_rad + np.pi) % (2 * np.pi) - np.pi)
