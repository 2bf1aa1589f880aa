"""LeRobot's own rollout over stand-ins while something fails: ``rollout_trials.py KIND TIMES OUT``.

The robot is ours, the policy the shipped one. It runs as a whole, but the moves it answers are
replaced by a sway, so that the arm moves for certain when the fault comes. A program of its own, so
that one that hangs can be ended; it adds a row per trial to the ledger in the folder OUT. Nothing
here was ever run on hardware.
"""

import itertools
import logging
import os
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from lerobot.policies.factory import PreTrainedConfig
from lerobot.rollout import RolloutConfig
from lerobot.scripts.lerobot_rollout import rollout

from benchmarks.ledger import Ledger
from benchmarks.recorder.rig import CAMERAS, SCENE_CYCLE, new_address
from benchmarks.trust.attempts import begun
from benchmarks.trust.hostile_arm import HostileStandIn
from benchmarks.trust.hostile_trials import AFTER_s, HOLD_s
from lerobot_policy_pi05_uniforce.action import NetworkUnits
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.sensors.config_uniforce import (
    UniforceSceneCameraConfig,
    UniforceTactileCameraConfig,
    UniforceUskinConfig,
)
from uniforce_robots.standins.process import StandIn
from uniforce_vtla.errors import FaultError
from uniforce_vtla.keys import AXES

# where the demonstrations were; the hand open
START = dict(zip(AXES, (0.495, -0.02, 0.06, 0.0, 0.08), strict=True))
NEAR_m = 0.01
LEAD_s = 30.0
SWAY_m = 0.015
SWAY_s = 1.0  # up to 0.09 m/s
Y = AXES.index("y.pos")
STEP_s = 1 / 30
BEGUN_steps = 15  # of the policy: what it answers before the robot is connected is a tenth of them
UNDER_WAY_s = (0.7, 1.5)  # then the arm goes on for so long before something fails
NOTICE_s = 6.0  # the rollout goes on for so long, if nobody notices
LAG_s = {"stall": 0.35, "none": 0.04}  # of a stream that lags: silent, alive
FREE = ("rest_s=2", "press_s=0")  # nothing is touched


@dataclass(frozen=True)
class Kind:
    """A fault, and the names it may be reported by: an exception's or a RobotError's."""

    breaks: Callable[["Rig"], object]
    names: tuple[str, ...]


@dataclass
class Sway:
    """In place of the network's sampler: it runs, and its moves become a sway; or it fails."""

    real: Callable[..., torch.Tensor]
    fault: str = ""
    steps: int = 0

    def __call__(self, model: PI05UniforcePytorch, *inputs: Any, **kwargs: Any) -> torch.Tensor:
        """Return (B, chunk, max_action_dim) in network units."""
        sampled = self.real(model, *inputs, **kwargs)
        if self.fault == "raises":
            raise RuntimeError("CUDA error: an illegal memory access was encountered")
        settings = model.config.action
        chunk = sampled.shape[1]
        begin_s = self.steps * STEP_s
        time_s = begin_s + STEP_s * (1 + torch.arange(chunk))
        moves = torch.zeros(1, chunk, len(AXES))
        moves[0, :, Y] = SWAY_m * (
            torch.sin(2 * torch.pi * time_s / SWAY_s) - np.sin(2 * np.pi * begin_s / SWAY_s)
        )
        if self.fault == "nan":
            moves += torch.nan
        self.steps += model.config.n_action_steps
        units = NetworkUnits(settings.delta_scale, settings.delta_knee, chunk).to_network(moves)
        return torch.nn.functional.pad(units, (0, sampled.shape[2] - len(AXES)))


class Rig:
    """Stand-ins of two cameras, a uSkin and a TacTip, and an arm of its own for every trial."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._closing = ExitStack()
        self.sway = Sway(PI05UniforcePytorch.sample_actions)
        self.over = threading.Event()  # the rollout of this trial
        start = self._closing.enter_context
        self.cameras = {}
        for name, sensor in CAMERAS.items():
            stand_in = StandIn("mjpeg", f"sensor={sensor}", *SCENE_CYCLE)
            self.cameras[name] = start(stand_in)
        self.uskin = start(StandIn("slcan", "rate_hz=200", *FREE))
        self.tactip = start(StandIn("mjpeg", "sensor=tactip", *FREE))

    def __enter__(self) -> "Rig":
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    @contextmanager
    def arm(self) -> Iterator[HostileStandIn]:
        """Have an arm, and everything whole, the arm where the demonstrations were."""
        for stand_in in (*self.cameras.values(), self.uskin, self.tactip):
            stand_in.inject("none")
        self.sway.fault = ""
        self.sway.steps = 0
        self.over.clear()
        with HostileStandIn(new_address()) as self.fci:
            self._lead()
            yield self.fci

    def settings(self, **more: Any) -> UniforceFrankaConfig:
        return UniforceFrankaConfig(
            id="rollout", calibration_dir=self.folder, address=self.fci.address, **more
        )

    def _lead(self) -> None:
        with UniforceFranka(self.settings()) as robot:
            end_s = time.monotonic() + LEAD_s
            while np.abs(robot.measured()[:3] - list(START.values())[:3]).max() > NEAR_m:
                robot.send_action(START)
                time.sleep(STEP_s)
                if time.monotonic() > end_s:
                    raise RuntimeError(f"the arm isn't led to its start: {robot.measured()}")

    def rollout(self) -> None:
        """Run LeRobot's program; it raises what ends it."""
        capture: dict[str, Any] = {"capture_width": 640, "capture_height": 480}
        cameras: dict[str, Any] = {}
        for name, stand_in in self.cameras.items():
            cameras[name] = UniforceSceneCameraConfig(
                source=stand_in.address, width=224, height=224, **capture
            )
        cameras["tactile_left"] = UniforceUskinConfig(
            finger="left",
            source=self.uskin.address,
            max_age_ms=200.0,  # as the cameras': 100 ms end a rollout on a busy machine
        )
        cameras["tactile_right"] = UniforceTactileCameraConfig(
            sensor="tactip", finger="right", source=self.tactip.address, **capture
        )
        policy = PreTrainedConfig.from_pretrained(shipped_checkpoint())
        policy.pretrained_path = shipped_checkpoint()
        config = RolloutConfig(
            robot=self.settings(cameras=cameras),
            policy=policy,
            task="wipe the ink off the board",
            duration=UNDER_WAY_s[1] + NOTICE_s,
            play_sounds=False,
        )
        sway = self.sway
        with mock.patch.object(
            PI05UniforcePytorch, "sample_actions", lambda *given, **more: sway(*given, **more)
        ):
            rollout(config)

    def lag(self, stand_in: StandIn) -> None:
        """Let a stream come in bursts until the rollout is over."""
        for fault in itertools.cycle(LAG_s):
            stand_in.inject(fault)
            if self.over.wait(LAG_s[fault]):
                return


def _stand_in(which: Callable[[Rig], StandIn]) -> Callable[..., Kind]:
    """Return what makes a fault of a stand-in."""

    def kind(fault: str, *names: str) -> Kind:
        if fault == "lag":
            return Kind(lambda rig: rig.lag(which(rig)), names)
        return Kind(lambda rig: which(rig).inject(fault), names)

    return kind


def _arm(fault: str, *names: str) -> Kind:
    return Kind(lambda rig: rig.fci.do("fault", name=fault), names)


def _policy(fault: str, name: str) -> Kind:
    return Kind(lambda rig: setattr(rig.sway, "fault", fault), (name,))


_finger = _stand_in(lambda rig: rig.tactip)
_taxels = _stand_in(lambda rig: rig.uskin)
_camera = _stand_in(lambda rig: rig.cameras["front"])
FROZEN = "FrozenSensorError"
STALE = "StaleSensorError"
LOST = "LostSensorError"
KINDS = {
    "finger_frozen": _finger("freeze", FROZEN),
    "finger_lagging": _finger("lag", STALE),
    "finger_unplugged": _finger("stop", LOST, STALE),
    "taxels_frozen": _taxels("freeze", FROZEN),
    "taxels_unplugged": _taxels("unplug", LOST, STALE),
    "camera_frozen": _camera("freeze", FROZEN),
    "camera_lagging": _camera("lag", STALE),
    "camera_gone": _camera("stop", LOST, STALE),
    "arm_frozen": _arm("frozen_state", "frozen"),
    "arm_silent": _arm("stopped_clock", "connection"),
    "arm_reflex": _arm("reflex", "reflex"),
    "user_stop": _arm("user_stop", "user_stop"),
    "hand_gone": _arm("hand_dropped", "hand_connection", "hand_stale"),
    "policy_raises": _policy("raises", "RuntimeError"),
    "policy_nan": _policy("nan", "RolloutError"),
}


@dataclass(frozen=True)
class Trial:
    """Result of one fault."""

    kind: str
    named: str  # the fault of a RobotError, or the class of another exception; "" for none
    message: str
    # the robot's own clock, from the fault until the arm was at rest; infinity while it moves
    hold_s: float
    learnt_s: float  # until the rollout had ended
    # how often it was begun in vain: a busy machine stopped the arm before, or for another reason
    starved: int = 0

    @property
    def is_named(self) -> bool:
        """Whether it was told by its name."""
        return self.named in KINDS[self.kind].names

    @property
    def is_held(self) -> bool:
        """Whether the arm was at rest in time."""
        return self.hold_s <= HOLD_s

    @property
    def is_right(self) -> bool:
        """Whether both are so."""
        return self.is_named and self.is_held


class Breaker(threading.Thread):
    """Breaks something once the arm has moved for a while."""

    def __init__(self, rig: Rig, kind: Kind) -> None:
        super().__init__(daemon=True)
        self._rig = rig
        self._kind = kind
        self.at_ms: int | None = None  # the robot's own clock; None: nothing was broken
        self.at_s = 0.0

    def run(self) -> None:
        """Wait, break, note when."""
        while self._rig.sway.steps < BEGUN_steps:
            if self._rig.over.wait(STEP_s):
                return
        if self._rig.over.wait(random.uniform(*UNDER_WAY_s)):
            return
        # it turns round
        while (look := self._rig.fci.do("look")["arm"])["held_since_ms"] is not None:
            if self._rig.over.wait(STEP_s):
                return
        self.at_ms = look["milliseconds"]
        self.at_s = time.monotonic()
        self._kind.breaks(self._rig)


def trial(name: str, rig: Rig) -> Trial:
    """Begin a rollout, break something, and look at what the arm did.

    Raises RuntimeError: the rollout ended before anything was broken.
    """
    with rig.arm() as fci:
        breaker = Breaker(rig, KINDS[name])
        breaker.start()
        named = ""
        message = ""
        try:
            rig.rollout()
        except Exception as error:  # whatever ends LeRobot's program
            named = error.fault if isinstance(error, FaultError) else type(error).__name__
            message = str(error)
        learnt_s = time.monotonic()
        rig.over.set()
        breaker.join()
        if breaker.at_ms is None or learnt_s < breaker.at_s + STEP_s:
            raise RuntimeError(f"{name}: the rollout ended by itself: {named} {message}")
        return Trial(
            name, named, message, hold_s(fci, breaker.at_ms), round(learnt_s - breaker.at_s, 3)
        )


def hold_s(fci: HostileStandIn, broken_ms: int) -> float:
    """Return how long the arm moved on, by its own clock; infinity while it moves."""
    arm = fci.look_after(AFTER_s)["arm"]
    if arm["held_since_ms"] is None:
        return float("inf")
    return max(arm["last_moving_ms"] - broken_ms, 0) / 1e3


def main() -> None:
    """Run what OUT lacks."""
    name, times, out = sys.argv[1:4]
    folder = Path(out)
    logging.disable(logging.ERROR)  # of LeRobot's loop, which says at every step how slow it is
    torch.set_num_threads(1)
    rows = Ledger(folder)
    with Rig(folder) as rig:
        for _ in range(len(rows.read(name)), int(times)):
            found, starved, _ = begun(name, lambda: trial(name, rig), lambda row: row.is_right)
            rows.add(name, asdict(replace(found, starved=starved)))


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # threads of a rollout that failed must not keep the program
