"""One process of the scorer: builds each arm's environment and controller once, then scores seeds.

Controls ask whether the policy uses touch. Masked touch, of both fingers or one, carries nothing.
Frozen touch stays as it was early in the wipe.
"""

import functools
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.utils.io_utils import write_video

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import Script
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_cli.boundary import worker_process
from uniforce_cli.score_settings import Rig, ScoreConfig, checkpoint_of
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.arms import EpisodeRow, row_of
from uniforce_vtla.evaluation.episode import WIPING_PHASE, ScoreLimits
from uniforce_vtla.evaluation.film import FILM_HZ, film
from uniforce_vtla.evaluation.pictures import write_trace_sheet
from uniforce_vtla.evaluation.rollout import Controller, Rollout, roll_out
from uniforce_vtla.keys import TACTILE_NAMES
from uniforce_vtla.results_file import write_json

log = logging.getLogger(__name__)
SCRIPTS: dict[str, Callable[[], Script]] = {"expert": WipeExpert}

FEELS_s = 0.5  # of wiping, before touch freezes
# control → fingers whose touch it takes away
FINGERS_WITHOUT_TOUCH: dict[str, tuple[Finger, ...]] = {
    "": (),
    "masked": FINGERS,
    "left_masked": ("left",),
    "right_masked": ("right",),
}


class ScriptController:
    """Drive an environment with a script that answers one action at a time."""

    def __init__(self, script: Any) -> None:
        self._script = script
        self._env: Any = None

    def reset(self, env: Any) -> None:
        self._env = env
        self._script.reset(env)

    def facts(self) -> dict[str, float]:
        """Return nothing: a script isn't timed."""
        return {}

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the script's next target as a chunk of one."""
        return np.asarray(self._script.act(self._env))[None]


def score_job(index: int, config: ScoreConfig, seed: int) -> tuple[int, EpisodeRow]:
    """Roll one episode of an arm out and return the arm's number and the row."""
    worker_process()
    env, controller = _build(config.policy_of(seed), config.rig, config.control, config.folder)
    film = seed < config.first_seed + config.videos or seed in config.film
    torch.manual_seed(seed)  # the policy's own noise is part of the paired seed
    rollout = roll_out(env, controller, seed, keep_shots=film)
    if film and rollout.shots:  # none of an episode that never began
        _keep(rollout, config)
    row = row_of(rollout)
    if row.outcome == "aborted":
        log.warning("scene %d is aborted: %s", seed, rollout.result.reasons[0])
    return index, row


@functools.lru_cache(maxsize=64)  # arms take turns, and training seeds within them
def _build(policy: str, rig: Rig, control: str, out: Path) -> tuple[WipeEnv, Controller]:
    """Build both once per process and store which sensors they run on."""
    controller: Controller
    if policy in SCRIPTS:
        if control:
            do = "Controls are for policies."
            raise ContractError(expected(f"control of the {policy}", "none", control, do))
        env = _scene(rig, drawn=())  # nothing is drawn: it reads the true wrench
        controller = ScriptController(SCRIPTS[policy]())
    else:
        env, plain = policy_on_rig(policy, rig)
        controller = with_control(plain, control)
    write_json(out / "sensors.json", {"notes": getattr(controller, "notes", []), **env.sensors})
    return env, controller


def with_control(controller: PolicyController, control: str) -> Controller:
    """Return the controller under a control of ``ScoreConfig``; "" is none.

    Raises ContractError: an unknown control.
    """
    if control == "frozen":
        return FrozenTouch(controller)
    if control not in FINGERS_WITHOUT_TOUCH:
        wanted = " | ".join([*filter(None, FINGERS_WITHOUT_TOUCH), "frozen"])
        raise ContractError(expected("control", wanted, repr(control), "Name one."))
    controller.policy.touch.hidden.update(FINGERS_WITHOUT_TOUCH[control])
    return controller


def _scene(rig: Rig, drawn: tuple[Finger, ...], expose_wrench: bool = False) -> WipeEnv:
    sensors = rig.mounted
    return WipeEnv(
        rig.level,
        sensors["left"],
        sensors["right"],
        drawn=drawn,
        expose_wrench=expose_wrench,
        gripper=rig.gripper,
    )


class FrozenTouch:
    """A controller whose touch stays, from half a second of wiping on, as it was then."""

    def __init__(self, inner: Controller) -> None:
        self._inner = inner

    def reset(self, env: Any) -> None:
        self._inner.reset(env)
        self._env = env
        self._wiping_from_s = np.inf
        self._kept: dict[str, np.ndarray] = {}

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the inner controller's chunk for this observation, its touch frozen in time."""
        pixels = observation["pixels"]
        times_s = self._env.trace.time_s
        time_s = float(times_s[-1]) if len(times_s) else 0.0
        if self._env.phase == WIPING_PHASE:
            self._wiping_from_s = min(self._wiping_from_s, time_s)
        if time_s - self._wiping_from_s < FEELS_s:
            self._kept = {name: pixels[name] for name in TACTILE_NAMES if name in pixels}
        return self._inner.chunk(observation | {"pixels": pixels | self._kept}, task)

    def facts(self) -> dict[str, float]:
        return self._inner.facts()


def policy_on_rig(policy: str, rig: Rig) -> tuple[WipeEnv, PolicyController]:
    """Return a scene and the checkpoint that acts in it; "shipped" is the package's own."""
    asked: dict[Finger, str] = {}
    if rig.left_sensor:
        asked["left"] = rig.kinds["left"]
    if rig.right_sensor:
        asked["right"] = rig.kinds["right"]
    controller = PolicyController(
        checkpoint_of(policy), rig.kinds, rig.swap, asked, rig.calibrations, rig.monitor
    )
    env = _scene(rig, controller.reads, controller.needs_true_wrench)
    return env, controller


def _keep(rollout: Rollout, config: ScoreConfig) -> None:
    sheet = config.folder / f"seed_{rollout.seed}.png"
    write_trace_sheet(sheet, rollout, title=f"{config.arm}, seed {rollout.seed}")
    frames = list(film(rollout, ScoreLimits().band_N))
    write_video(config.video(rollout.seed), frames, fps=FILM_HZ)
