"""Could a policy without touch know the press after all?  Fixed regressors try; they should fail, and touch succeed.

Forbidding force in the observation isn't enough: a camera might see the felt bend, the state might sag by a known
stiffness. Trees read three frames of state, a small CNN three frames of both cameras. The check counts only if the
same trees read the press well from touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.metrics import r2_score
from torch import nn
from tqdm import tqdm

from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from lerobot_env_uniforce_wiping.disturbance import Nudge
from lerobot_env_uniforce_wiping.hands import TouchSettings
from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import CAMERAS, tactile_name
from uniforce_vtla.probes.plain_touch import descriptors
from uniforce_vtla.results_file import provenance, write_json

HISTORY = 3  # frames a regressor sees, the last one now
HISTORY_STEP = 3  # control steps between them: 0.1 s
EVERY = 5  # control steps between two samples
WIPING = 2  # phase of the trace
PRESS_RANGE_N = (
    3.0,
    12.0,
)  # wanted press, drawn per scene: an expert that always presses alike leaks nothing
LEAK_LIMIT, TOUCH_FLOOR = 0.3, 0.75  # R²


@dataclass
class LeakConfig:
    """Regress the press on the board from what a policy without touch observes; write leak_check.json.

    Example: uniforce-leak-check level=paper scenes=60
    """

    level: str = "paper"  # locked level
    scenes: int = 60  # expert episodes, each with a press of its own; two thirds train, the rest test
    first_seed: int = 60_000  # not used elsewhere
    image_side: int = 56  # px, the tiny policy's cameras
    cnn_steps: int = 600  # of 64 samples
    out: str = "docs/results/leak_check.json"  # result file


@dataclass(frozen=True)
class Samples:
    """Moments of wiping: (N, …) inputs, what was pressed, and which scene each is from."""

    state: np.ndarray  # (N, 15): measured x, y, z, yaw, width, three frames
    command: np.ndarray  # (N, 15): the targets issued, three frames; a policy knows its own
    touch: np.ndarray  # (N, 12): hand descriptors of both fingers now
    cameras: np.ndarray  # (N, 18, S, S) uint8: two cameras, three frames
    press_N: np.ndarray  # (N,)
    scene: np.ndarray  # (N,)


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
    env.start(seed)
    expert.reset(env)
    past: list[tuple[np.ndarray, np.ndarray, np.ndarray | None]] = []
    done, step = False, 0
    while not done:
        target = nudge.apply(expert.act(env))
        done, step = env.advance(target), step + 1
        wiping = env.trace.phase[-1] == WIPING
        looks = wiping and step % HISTORY_STEP == 0
        past.append((env.state, target, _pictures(env, config.image_side) if looks else None))
        frames = past[-1 - (HISTORY - 1) * HISTORY_STEP :: HISTORY_STEP]
        if looks and step % (EVERY * HISTORY_STEP) == 0 and all(frame[2] is not None for frame in frames):
            state, command, pictures = (np.concatenate(part) for part in zip(*frames, strict=True))
            yield state, command, _touch(env), pictures, env.sim.press_N


def _pictures(env: WipeEnv, side: int) -> np.ndarray:
    pixels = env.observe()["pixels"]
    small = [cv2.resize(pixels[name], (side, side), interpolation=cv2.INTER_AREA) for name in CAMERAS]
    return np.concatenate(small, axis=-1).transpose(2, 0, 1)  # (6, S, S)


def _touch(env: WipeEnv) -> np.ndarray:
    pixels = env.observe()["pixels"]
    pairs = [
        (pixels[tactile_name(f, reference=True)][..., 0], pixels[tactile_name(f)][None, ..., 0], f)
        for f in FINGERS
    ]
    return np.concatenate([descriptors(*pair)[0] for pair in pairs])


def measure(samples: Samples, cnn_steps: int) -> dict[str, float]:
    """Return R² of the press on unseen scenes, for each input."""
    train = samples.scene < round(2 / 3 * (samples.scene.max() + 1))
    flat = {
        "state": samples.state,
        "state and own targets": np.hstack([samples.state, samples.command]),
        "touch": samples.touch,
        "touch and state": np.hstack([samples.touch, samples.state]),
    }
    found = {}
    for name, inputs in flat.items():
        trees = HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, random_state=0)
        trees.fit(inputs[train], samples.press_N[train])
        found[name] = float(r2_score(samples.press_N[~train], trees.predict(inputs[~train])))
    said = _cnn(samples, train, cnn_steps)
    found["cameras and state"] = float(r2_score(samples.press_N[~train], said))
    return found


def _cnn(samples: Samples, train: np.ndarray, steps: int) -> np.ndarray:
    """Train a small CNN on cameras and state, and return what it says of the unseen scenes."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = PressCNN(samples.cameras.shape[1], samples.state.shape[1])
    mean, sd = samples.press_N[train].mean(), samples.press_N[train].std()
    center, spread = samples.state[train].mean(axis=0), samples.state[train].std(axis=0) + 1e-6
    state = torch.from_numpy((samples.state - center) / spread).float()
    press = torch.from_numpy((samples.press_N - mean) / sd).float()
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3, weight_decay=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    rng, known = np.random.default_rng(0), np.flatnonzero(train)
    for _ in tqdm(range(steps), desc="CNN"):
        rows = rng.choice(known, 64)
        loss = (model(samples.cameras[rows], state[rows]) - press[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        said = [
            model(samples.cameras[rows], state[rows])
            for rows in np.array_split(np.flatnonzero(~train), 20)
            if len(rows)
        ]
    return torch.cat(said).numpy() * sd + mean


class PressCNN(nn.Module):
    """Three strided convolutions over stacked frames, joined by the state."""

    def __init__(self, channels: int, state: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in ((channels, 24), (24, 32), (32, 48)):
            layers += [nn.Conv2d(before, after, 5, stride=2, padding=2), nn.GELU()]
        self.look = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(4), nn.Flatten())
        self.answer = nn.Sequential(nn.Linear(48 * 16 + state, 96), nn.GELU(), nn.Linear(96, 1))

    def forward(self, cameras: np.ndarray, state: torch.Tensor) -> torch.Tensor:
        """Return (B,) press in units of its spread from (B, C, S, S) uint8 pictures and (B, F) state."""
        seen = self.look(torch.from_numpy(cameras).float() / 255 - 0.5)
        return self.answer(torch.cat([seen, state], dim=1))[:, 0]


def verdict(found: dict[str, float]) -> str:
    """Say in a sentence whether the scene leaks, or whether the check proves nothing."""
    if found["touch and state"] < TOUCH_FLOOR:
        return f"proves nothing: even touch reads the press at R² {found['touch and state']:.2f} only"
    blind = max(found["state"], found["cameras and state"])
    word = "no leak" if blind < LEAK_LIMIT else "LEAK"
    return f"{word}: R² {blind:.2f} without touch, {found['touch and state']:.2f} with it"


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-leak-check``."""
    config = parse(LeakConfig, argv)
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
