"""Drive the robot's whole chain, from action to pose, with random limits, states and actions.

``guard_oracle`` judges each pose and each action. Beside that: what is wrong stops the arm within
one tick under its own name, what is right is never refused, nothing is sent after a fault, and
after ``recover`` the first target is the measured pose. In a share of the episodes the stream's own
target is replaced by one that drifts, jumps or is no number, so that the last check stands alone.
"""

import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.trust.guard_oracle import SLACK, axes_of, pose_of, wrong_action, wrong_pose
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka import robot as robot_module
from uniforce_robots.franka.arm import ArmState
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.limits import StreamSettings
from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.franka.stream import ArmStream
from uniforce_vtla.errors import RobotError
from uniforce_vtla.hand import HandReading
from uniforce_vtla.keys import AXES

STEPS = 50  # actions in an episode
# share of the way to a target per tick
MOTIONS = {"follows": 1.0, "lags": 0.3, "blocked": 0.0, "pushed": 0.5}
LIES = {  # what an arm may say that can't be, or that forbids motion, and the names that fit
    "pose": ("bad_state",),
    "q": ("bad_state",),
    "dq": ("bad_state",),
    "mirror": ("bad_state",),
    "wrench": ("force",),
    "fast": ("speed",),
    "jump": ("jump",),
    "backwards": ("bad_state",),
    "reflex": ("reflex",),
    "user_stopped": ("user_stop",),
    "guiding": ("guiding",),
}
# of them, the last ones, are none in a first reading: nothing to compare with, nothing that moves
LATER = 5
LIE_SHARE, SABOTAGE_SHARE = 0.004, 0.3
GARBAGE: tuple[Any, ...] = (
    *(None, "0.4", "nan", [], [1.0, 2.0], {}, True, b"0", object()),
    *(np.nan, np.inf, -np.inf),
)


@dataclass
class Clock:
    """A clock that is set."""

    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class ScriptedArm:
    """Moves as its name says, at times says what can't be; keeps each target and its time."""

    clock: Clock
    rng: np.random.Generator
    axes: np.ndarray  # (4,)
    motion: str
    lies: bool
    # time s, target, where it was
    sent: list[tuple[float, np.ndarray, np.ndarray]] = field(default_factory=list)
    right_names: tuple[str, ...] = ()  # of the fault it has reported
    readings: int = 0

    def state(self) -> ArmState:
        lie = ""
        if self.lies and self.rng.random() < LIE_SHARE:
            lie = str(self.rng.choice(list(LIES)[: None if self.readings else -LATER]))
            self.right_names = LIES[lie]
        self.readings += 1
        if lie == "jump":
            self.axes = self.axes + np.array([*self.rng.choice([-0.06, 0.06], 3), 0.0])
        said = {"pose": pose_of(self.axes), "q": self.rng.normal(0, 1e-6, 7)}
        said |= {"dq": np.zeros(7), "wrench": np.zeros(6)}
        if lie in said:
            said[lie].flat[self.rng.integers(6)] = self.rng.choice([np.nan, np.inf, -np.inf])
        if lie == "fast":
            said["dq"][self.rng.integers(7)] = 20.0
        if lie == "mirror":
            said["pose"][:3, 2] *= -1
        now_s = self.clock()
        robot_s = now_s - 5.0 * (lie == "backwards")
        mode = lie if lie in ("reflex", "user_stopped", "guiding") else "move"
        return ArmState(
            now_s, robot_s, said["q"], said["dq"], said["pose"], said["wrench"], mode, 1.0
        )

    def set_target(self, ee_to_base: np.ndarray) -> None:
        target = axes_of(ee_to_base)
        self.sent.append((self.clock(), target, self.axes))
        step = target - self.axes
        step[3] = (step[3] + np.pi) % (2 * np.pi) - np.pi
        step *= MOTIONS[self.motion]
        if self.motion == "pushed":
            step += self.rng.normal(0, 0.003, 4)
        # as fast as an arm can be
        self.axes = self.axes + step * 0.004 / max(float(np.linalg.norm(step)), 0.004)

    def recover(self) -> None:
        self.right_names, self.readings = (), 0

    def stop(self, at_once: bool = False) -> None:
        """Do nothing."""

    connect = close = set_gains = stop


class ScriptedHand:
    """A hand that is well and goes to each width at once."""

    def __init__(self, clock: Clock, width_m: float) -> None:
        self._clock, self.width_m = clock, width_m

    def check(self) -> None:
        """Nothing is wrong."""

    tick = recover = close = stop = halt = check

    @property
    def reading(self) -> HandReading:
        return HandReading(self._clock(), self.width_m, 0.08, False)

    def submit(self, width_m: float) -> None:
        self.width_m = width_m


class TickedStream(ArmStream):
    """A stream without its thread: the cases tick it themselves."""

    def start(self) -> None:
        self.read_first()

    def stop(self) -> None:
        self._ending.set()


def random_limits(rng: np.random.Generator) -> GuardLimits:
    centre = rng.uniform([0.3, -0.3, 0.1, -1, 0.03], [0.6, 0.3, 0.4, 1, 0.05])
    half = rng.uniform(0.01, 0.03, 5) * [*rng.uniform(1, 8, 4), 1]
    hardest = {
        "step_m": 0.1,
        "step_rad": 0.8,
        "speed_m_s": 0.5,
        "speed_rad_s": 2.5,
        "speed_width_m_s": 0.2,
    }
    drawn: dict[str, Any] = {
        name: float(high * rng.uniform(0.01, 1)) for name, high in hardest.items()
    }
    corners = tuple((centre - half).tolist()), tuple((centre + half).tolist())
    return GuardLimits(*corners, **drawn, longest_gap_s=rng.uniform(0.01, 0.2))


def random_action(rng: np.random.Generator, here: np.ndarray) -> tuple[dict[str, Any], bool]:
    """Return an action and whether it is one: near, far, absurd or broken."""
    kind = str(rng.choice(["near", "far", "absurd", "broken"], p=[0.63, 0.33, 0.03, 0.01]))
    scale = {"near": 0.01, "far": 0.5, "absurd": 1e9}.get(kind, 0.0)
    wanted = np.array([*here, 0.05]) + scale * rng.normal(0, 1, 5)
    action: dict[str, Any] = dict(zip(AXES, wanted.tolist(), strict=True))
    if kind != "broken":
        return action, True
    axis, choice = str(rng.choice(AXES)), int(rng.integers(-1, len(GARBAGE)))
    if choice < 0:
        del action[axis]
    else:
        action[axis] = GARBAGE[choice]
    return action, False


class Episode:
    """One robot with its own limits, and what was wrong with it."""

    def __init__(self, rng: np.random.Generator, folder: Path) -> None:
        self.rng, self.clock, self.limits = rng, Clock(), random_limits(rng)
        away = rng.normal(0, 0.02, 5) * (rng.random() < 0.3)  # it may begin outside its box
        *axes, width_m = rng.uniform(self.limits.low, self.limits.high) + away
        motion = str(rng.choice(list(MOTIONS)))
        self.arm = ScriptedArm(self.clock, rng, np.array(axes), motion, lies=rng.random() < 0.5)
        self.hand = ScriptedHand(self.clock, float(np.clip(width_m, 0, 0.08)))
        self.sabotaged = rng.random() < SABOTAGE_SHARE
        self.drift = rng.normal(0, 1, 4)
        self.wrong: list[str] = []
        self.faults: list[str] = []
        self.poses = 0
        settings = StreamSettings(stale_s=rng.uniform(0.02, 1.0))
        with mock.patch.object(robot_module, "make_backend", lambda config: (self.arm, self.hand)):
            config = UniforceFrankaConfig(
                id="cases", calibration_dir=folder, guards=self.limits, stream=settings
            )
            self.robot = UniforceFranka(config, self.clock)
        self.robot._hand = self.hand  # type: ignore[assignment]
        self._begin(lambda: self.robot._start_stream(self.hand))  # type: ignore[arg-type]

    def step(self) -> None:
        """Send one action and let the stream tick a few times; the clock may stand or leap."""
        try:
            if self.rng.random() < 0.9:
                self._act()
            for _ in range(self.rng.integers(1, 5)):
                pauses_s = [0, 1e-3, 1e-2, 0.03, 0.15]
                self.clock.now_s += float(self.rng.choice(pauses_s, p=[0.05, 0.1, 0.6, 0.2, 0.05]))
                self._tick()
        except RobotError as fault:
            self._stopped(fault)

    def _begin(self, start: Any) -> None:
        while True:
            try:
                start()
                break
            except RobotError as fault:
                self._judge_name(fault)
                self.arm.recover()
        self.stream: ArmStream = self.robot._stream  # type: ignore[assignment]
        self.action: tuple[float, np.ndarray] | None = None
        self.asked: np.ndarray | None = None
        self.held: np.ndarray | None = None
        self.first = len(self.arm.sent)  # of the poses since this start
        real = self.stream._advance
        target = lambda now_s: self._meddle(real(now_s), now_s)  # noqa: E731
        self.stream._advance = target  # type: ignore[method-assign]

    def _act(self) -> None:
        action, sound = random_action(self.rng, self.arm.axes)
        measured = np.array([*axes_of(self.stream.state.ee_to_base), self.hand.width_m])
        if not sound:
            self.arm.right_names = ("action",)
        sent = np.array(list(self.robot.send_action(action).values()))
        now_s = self.clock()
        last_s, last = self.action or (now_s, None)
        if self.held is not None:  # after a rest an action counts from there
            last_s, last = -np.inf, np.array([*self.held, measured[4]])
        self._note(wrong_action(self.limits, sent, measured, last, now_s - last_s))
        self._note(["an action that is none was taken"] * (not sound))
        self._note(["another width than was said"] * (self.hand.width_m != sent[4]))
        self.action, self.held = (now_s, sent), None

    def _tick(self) -> None:
        count, here = len(self.arm.sent), self.arm.axes
        try:
            self.stream.tick()
        except RobotError as fault:
            self.stream.halt(fault)  # its thread ends with what it raised
            raise
        self._note(["went on after a reading that can't be"] * bool(self.arm.right_names))
        if len(self.arm.sent) == count:
            return
        now_s, target, here = self.arm.sent[-1]
        last_s, last, _ = self.arm.sent[-2] if count > self.first else (now_s, None, None)
        self._note(wrong_pose(self.limits, target, here, last, now_s - last_s))
        if self.action is not None and now_s - self.action[0] > self.stream.settings.stale_s:
            self.held = here if self.held is None else self.held
        if not self.sabotaged:
            self._note(["began elsewhere"] * (last is None and np.abs(target - here).max() > 1e-9))
            # without a new action the target has to be where the arm was, and stay there
            follows = self.held is not None and np.abs(target - self.held).max() > 1e-9
            self._note(["follows an old action"] * bool(follows))

    def _meddle(self, target: ToolPose | None, now_s: float) -> ToolPose | None:
        """Return the stream's own target, or what a mistake further up might have made of it."""
        if target is not None and self.sabotaged and self.arm.sent and self.rng.random() > 0.3:
            target = self._sabotage(now_s)
        self.asked = None if target is None else np.array([*target.position_m, target.yaw_rad])
        return target

    def _sabotage(self, now_s: float) -> ToolPose:
        last_s, last, _ = self.arm.sent[-1]
        elapsed_s = min(now_s - last_s, self.limits.longest_gap_s)
        speeds = np.array([self.limits.speed_m_s] * 3 + [self.limits.speed_rad_s])
        way = self.drift / [*[np.linalg.norm(self.drift[:3])] * 3, abs(self.drift[3])]
        pace = self.rng.choice([0.9, 0.999, 1.001, 1.1, 30.0], p=[0.8, 0.1, 0.04, 0.05, 0.01])
        asked = last + pace * speeds * elapsed_s * way
        if self.rng.random() < 0.005:
            asked[self.rng.integers(4)] = self.rng.choice([np.nan, np.inf])
        return ToolPose(asked[:3], float(asked[3]))

    def _stopped(self, fault: RobotError) -> None:
        self._judge_name(fault)
        count = len(self.arm.sent)
        try:
            self.robot.send_action(dict(zip(AXES, [*self.arm.axes, 0.05], strict=True)))
            self._note(["an action was taken after a fault"])
        except RobotError:
            if not self.stream._ending.is_set():
                self.stream.tick()
        self._note(["a pose was sent after a fault"] * (len(self.arm.sent) > count))
        self._begin(self.robot.recover)

    def _judge_name(self, fault: RobotError) -> None:
        self.faults.append(fault.fault)
        if fault.fault == "guard" and self.asked is not None:
            self._judge_refusal(self.asked)
        elif fault.fault not in self.arm.right_names:
            self._note([f"{fault.fault} in place of {self.arm.right_names or 'nothing'}: {fault}"])

    def _judge_refusal(self, asked: np.ndarray) -> None:
        """Note a pose that was refused though nothing was wrong with it, by more than rounding."""
        last_s, last, _ = (
            self.arm.sent[-1] if len(self.arm.sent) > self.first else (self.clock(), None, None)
        )
        given = (self.limits, asked, self.arm.axes, last, self.clock() - last_s)
        wrong, surely = wrong_pose(*given, slack=-SLACK), wrong_pose(*given)
        pushed = self.arm.motion == "pushed" and "near" in wrong and surely in ([], ["near"])
        if not (pushed or (self.sabotaged and wrong)):
            self._note(
                [f"a pose was refused that is good, or was asked for by the stream: {wrong}"]
            )

    def _note(self, wrong: list[str]) -> None:
        self.wrong += [f"{what} at {self.clock.now_s:.3f} s" for what in wrong]


def drive(episodes: int, seed: int = 0) -> dict[str, Any]:
    """Run episodes of ``STEPS`` actions; return the counts of each kind, and each violation."""
    rng, faults = np.random.default_rng(seed), Counter[str]()
    counts: dict[str, Any] = {"actions": episodes * STEPS, "sent": 0, "violations": []}
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.object(robot_module, "ArmStream", TickedStream),
    ):
        for _ in range(episodes):
            episode = Episode(rng, Path(folder))
            for _ in range(STEPS):
                episode.step()
            counts["sent"] += len(episode.arm.sent)
            counts["violations"] += episode.wrong
            faults.update(episode.faults)
    return counts | {"faults": dict(sorted(faults.items()))}
