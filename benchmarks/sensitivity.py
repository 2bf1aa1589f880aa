"""What does a policy look at?  The same noise, one input exchanged, and how far the chunk moves.

The idea of N0-VTLA's modality probe: a change of the chunk is measured against what other noise would have done,
separately with and without contact. A policy that ignores touch moves no further than zero.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_cli.boundary import Level, Sensor, command
from uniforce_cli.score import Rig
from uniforce_cli.score_worker import policy_on_rig
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import CAMERAS, TACTILE_NAMES, tactile_name
from uniforce_vtla.options import Count, OutFile, PolicyFolder, Seed, Slots
from uniforce_vtla.results_file import provenance, write_json

CONTACT_N = 0.5  # mean grip above this counts as contact
EVERY = 15  # control steps between two looks
NOISE_DRAWS = 4  # per look, to know how far noise alone moves a chunk

Observation = dict[str, Any]
# this look and another one → what the policy gets
Exchange = Callable[[Observation, Observation], Observation]


@dataclass
class SensitivityConfig:
    """Exchange one input at a time and measure the change of the action chunk; write sensitivity.json.

    Example: python -m benchmarks.sensitivity policy=outputs/arms/vt level=paper scenes=5
    """

    policy: PolicyFolder = "shipped"  # checkpoint folder
    level: Level = "paper"  # level of the scenes looked at; what the shipped policy learnt at
    left_sensor: Sensor = ""  # gelsight | tactip | uskin; "" = gelsight
    right_sensor: Sensor = ""  # likewise; "" = tactip
    swap: Slots = ""  # which finger fills which slot
    scenes: Count = 5  # expert episodes
    first_seed: Seed = 70_000  # not used elsewhere
    out: OutFile = "outputs/sensitivity.json"  # result file


@dataclass(frozen=True)
class Look:
    """What the policy would see at one moment of an expert's episode."""

    observation: Observation
    task: str
    contact: bool


def looks(env: WipeEnv, scenes: int, first_seed: int) -> list[Look]:
    """Return moments of expert episodes, with and without contact."""
    expert, found = WipeExpert(), []
    for seed in tqdm(range(first_seed, first_seed + scenes), desc="scenes"):
        env.start(seed)
        expert.reset(env)
        done, step = False, 0
        while not done:
            if step % EVERY == 0:
                grip = np.mean([w[2] for w in env.true_wrench().values()])
                found.append(Look(env.observe(), env.task, bool(grip > CONTACT_N)))
            done, step = env.advance(expert.act(env)), step + 1
    return found


def exchanges(wrench: bool) -> dict[str, Exchange]:
    """Return what is exchanged, by name; touch is marker images, or the true wrench where a policy is fed that."""
    found: dict[str, Exchange] = {
        "touch as in free air": _free_air_wrench if wrench else _free_air,
        "touch of another moment": _other_wrench if wrench else _other_touch,
    }
    return found | {f"{camera} camera black": _black(camera) for camera in CAMERAS}


def _with(observation: Observation, pixels: dict[str, np.ndarray]) -> Observation:
    return observation | {"pixels": observation["pixels"] | pixels}


def _free_air(here: Observation, _: Observation) -> Observation:
    pixels = here["pixels"]
    return _with(here, {tactile_name(f): pixels[tactile_name(f, reference=True)] for f in FINGERS})


def _other_touch(here: Observation, there: Observation) -> Observation:
    return _with(here, {name: there["pixels"][name] for name in TACTILE_NAMES})


def _free_air_wrench(here: Observation, _: Observation) -> Observation:
    return here | {f"wrench_{f}": np.zeros_like(here[f"wrench_{f}"]) for f in FINGERS}


def _other_wrench(here: Observation, there: Observation) -> Observation:
    return here | {f"wrench_{f}": there[f"wrench_{f}"] for f in FINGERS}


def _black(camera: str) -> Exchange:
    return lambda here, _: _with(here, {camera: np.zeros_like(here["pixels"][camera])})


def measure(controller: PolicyController, moments: list[Look], seed: int = 0) -> dict[str, Any]:
    """Return per exchange the median change of the chunk, with and without contact; other noise beside them.

    A change is the RMS over steps and axes, each axis in its own ``delta_scale``.
    """
    config, rng = controller.config, np.random.default_rng(seed)
    scale = np.array(config.action.delta_scale)
    shape = (1, config.chunk_size, config.max_action_dim)
    generator = torch.Generator().manual_seed(seed)
    touched = [moment for moment in moments if moment.contact]
    changes: dict[str, list[float]] = {name: [] for name in (*exchanges(False), "other noise")}
    for moment in tqdm(moments, desc="looks"):
        noise = torch.randn(NOISE_DRAWS, *shape, generator=generator)
        chunks = [_chunk(controller, moment, moment.observation, n) / scale for n in noise]
        changes["other noise"].append(float(np.std(chunks, axis=0).mean()))
        other_look = touched[int(rng.integers(len(touched)))].observation
        for name, exchange in exchanges(controller.needs_true_wrench).items():
            other = _chunk(controller, moment, exchange(moment.observation, other_look), noise[0]) / scale
            changes[name].append(float(np.sqrt(np.mean((other - chunks[0]) ** 2))))
    contact = np.array([moment.contact for moment in moments])
    return {
        name: {
            "contact": float(np.median(np.array(values)[contact])),
            "no contact": float(np.median(np.array(values)[~contact])),
        }
        for name, values in changes.items()
    }


def _chunk(controller: PolicyController, moment: Look, observation: Observation, noise: torch.Tensor) -> np.ndarray:
    controller.reset(None)  # no issued target: both chunks start from the measured state
    return controller.predict(observation, moment.task, noise)


def _run(config: SensitivityConfig) -> str:
    rig = Rig(config.level, config.left_sensor, config.right_sensor, config.swap)
    env, controller = policy_on_rig(config.policy, rig)
    moments = looks(env, config.scenes, config.first_seed)
    found = measure(controller, moments)
    counts = {"contact": sum(m.contact for m in moments), "no contact": sum(not m.contact for m in moments)}
    content = {"policy": config.policy, "level": config.level, "looks": counts, "rms_change": found}
    written = write_json(Path(config.out), content | provenance())
    lines = [f"{'exchanged':26s} contact  no contact   (RMS change of the chunk, median)"]
    lines += [f"{name:26s} {v['contact']:7.3f} {v['no contact']:11.3f}" for name, v in found.items()]
    return "\n".join([*lines, f"written to {written}"])


@command(SensitivityConfig)
def main(config: SensitivityConfig) -> None:
    """Entry of ``python -m benchmarks.sensitivity``."""
    torch.set_num_threads(1)
    print(_run(config))


if __name__ == "__main__":
    sys.exit(main())
