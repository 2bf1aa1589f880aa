"""Could a policy without touch know the press after all?  Fixed regressors try; they should fail, and touch succeed.

Forbidding force in the observation isn't enough: a camera might see the felt bend, the state might sag by a known
stiffness.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import torch
from tqdm import tqdm

from benchmarks.press_regressors import FRAMES, Samples, measure, verdict
from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from lerobot_env_uniforce_wiping.disturbance import Nudge
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.expert import TouchSettings
from uniforce_cli.boundary import command
from uniforce_cli.option_types import Level
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import CAMERAS, tactile_name
from uniforce_vtla.options import Count, OutFile, Pixels, Range, Seed
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.plain_touch import descriptors

HISTORY_STEP = 3  # control steps between them: 0.1 s
EVERY = 5  # looks between two samples
PRESS_RANGE_N = (
    3.0,
    12.0,
)  # wanted press, drawn per scene: an expert that always presses alike leaks nothing
TOUCHING_N = 0.5  # a nudged hand is pushed off the board now and then


Scenes = Annotated[int, Range(3, 10_000)]  # two thirds train, the rest test


@dataclass
class LeakConfig:
    """Regress the press on the board from what a policy without touch observes; write leak_check.json.

    Example: python -m benchmarks.leak_check level=paper scenes=60
    """

    level: Level = "paper"  # locked level
    scenes: Scenes = 60  # expert episodes, each with a press of its own; two thirds train, the rest test
    first_seed: Seed = 60_000  # not used elsewhere
    image_side: Pixels = 56  # px, the tiny policy's cameras
    cnn_steps: Count = 600  # of 64 samples
    out: OutFile = "outputs/leak_check/leak_check.json"  # result file


def collect(config: LeakConfig) -> Samples:
    """Let experts press differently in different scenes and note what each sees."""
    env = WipeEnv(config.level)
    rows: list[tuple[Any, ...]] = []
    for scene in tqdm(range(config.scenes), desc="scenes", unit="scene"):
        rows += [(*row, scene) for row in _episode(env, config, config.first_seed + scene)]
    state, command, touch, cameras, press, scenes = (np.stack(column) for column in zip(*rows, strict=True))
    return Samples(state, command, touch, cameras, press, scenes)


def _episode(env: WipeEnv, config: LeakConfig, seed: int) -> Iterator[tuple[Any, ...]]:
    wanted_N = float(np.random.default_rng([seed, 5]).uniform(*PRESS_RANGE_N))
    expert, nudge = WipeExpert(settings=TouchSettings(press_N=wanted_N)), Nudge(seed)
    past: list[tuple[np.ndarray, np.ndarray, np.ndarray | None]] = []
    for step, target in enumerate(walk(env, expert, seed, nudge), start=1):
        # Only while the eraser sweeps and presses: a hand off the board presses nothing, and anybody sees that.
        looks = expert.phase == "wipe" and env.sim.press_N > TOUCHING_N and step % HISTORY_STEP == 0
        pixels = env.observe()["pixels"] if looks else {}
        past.append((env.state, target, _pictures(pixels, config.image_side) if looks else None))
        frames = past[-1 - (FRAMES - 1) * HISTORY_STEP :: HISTORY_STEP]
        if looks and step % (EVERY * HISTORY_STEP) == 0 and all(frame[2] is not None for frame in frames):
            state, command, pictures = (np.concatenate(part) for part in zip(*frames, strict=True))
            yield state, command, _touch(pixels), pictures, env.sim.press_N


def _pictures(pixels: dict[str, np.ndarray], side: int) -> np.ndarray:
    small = [cv2.resize(pixels[name], (side, side), interpolation=cv2.INTER_AREA) for name in CAMERAS]
    return np.concatenate(small, axis=-1).transpose(2, 0, 1)  # (6, S, S)


def _touch(pixels: dict[str, np.ndarray]) -> np.ndarray:
    pairs = [
        (pixels[tactile_name(f, reference=True)][..., 0], pixels[tactile_name(f)][None, ..., 0], f)
        for f in FINGERS
    ]
    return np.concatenate([descriptors(*pair)[0] for pair in pairs])


@command(LeakConfig)
def main(config: LeakConfig) -> int:
    """Entry of ``python -m benchmarks.leak_check``."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    samples = collect(config)
    found = measure(samples, config.cnn_steps)
    content = {
        "what": "simulated; R² of the press on scenes the regressors never saw",
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "scenes": config.scenes,
        "samples": len(samples.press_N),
        "press_sd_N": float(samples.press_N.std()),
        "r2": found,
        "verdict": verdict(found),
    }
    path = write_json(Path(config.out), content | provenance())
    for name, value in found.items():
        print(f"{name:24s} R² {value:.2f}")
    print(f"{content['verdict']}; written to {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
