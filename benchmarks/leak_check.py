"""Could a policy without touch know the press after all?  Fixed regressors try; they should fail, and touch succeed.

Forbidding force in the observation isn't enough: a camera might see the felt bend, the arm might lag behind its
targets by a known stiffness. Trees read a second of poses and targets, a small CNN three frames of both cameras
beside them; the check counts only if the same trees read the press well from touch.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import torch
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.metrics import r2_score
from torch import nn
from tqdm import tqdm

from benchmarks.descriptor_heads import described_now
from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.expert import AGAINST_PULL
from uniforce_cli.boundary import Level, command, one_thread
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import CAMERAS
from uniforce_vtla.options import Count, OutFile, Pixels, Range, Seed
from uniforce_vtla.results_file import provenance, write_json

LEAK_LIMIT, TOUCH_FLOOR = 0.3, 0.75  # R²
PAST = 10  # poses and targets of a sample
FRAMES = 3  # and pictures, the latest ones
HISTORY_STEP = 3  # control steps between them: 0.1 s
EVERY = 5  # looks between two samples
# wanted press, drawn per scene: an expert that always presses alike leaks nothing
PRESS_RANGE_N = (3.0, 12.0)
TOUCHING_N = 0.5  # a hand is pulled off the board now and then


Scenes = Annotated[int, Range(3, 10_000)]  # two thirds train, the rest test


@dataclass
class LeakConfig:
    """Regress the press on the board from what a policy without touch observes; write leak_check.json.

    Example: python -m benchmarks.leak_check level=touch scenes=60
    """

    level: Level = "touch"  # locked level
    scenes: Scenes = 60  # expert episodes, each with a press of its own; two thirds train, the rest test
    first_seed: Seed = 60_000  # not used elsewhere
    image_side: Pixels = 56  # px, the tiny policy's cameras
    cnn_steps: Count = 600  # of 64 samples
    out: OutFile = "outputs/leak_check/leak_check.json"  # result file


@dataclass(frozen=True)
class Samples:
    """Moments of wiping: (N, …) inputs, what was pressed, and which scene each is from."""

    pose: np.ndarray  # (N, 50): measured x, y, z, yaw, width over a second, the latest last
    command: np.ndarray  # (N, 50): the targets issued meanwhile; a policy knows its own
    touch: np.ndarray  # (N, 12): hand descriptors of both fingers now
    cameras: np.ndarray  # (N, 18, S, S) uint8: two cameras, three frames
    press_N: np.ndarray  # (N,)
    scene: np.ndarray  # (N,)

    @property
    def moves(self) -> np.ndarray:
        """Return (N, 45): how the targets changed from frame to frame."""
        frames = self.command.reshape(len(self.command), PAST, -1)
        return np.diff(frames, axis=1).reshape(len(frames), -1)


def collect(config: LeakConfig) -> Samples:
    """Let experts press differently in different scenes and note what each sees."""
    env = WipeEnv(config.level)
    rows: list[tuple[Any, ...]] = []
    for scene in tqdm(range(config.scenes), desc="scenes", unit="scene"):
        rows += [(*row, scene) for row in _episode(env, config, config.first_seed + scene)]
    return Samples(*(np.stack(column) for column in zip(*rows, strict=True)))


def _episode(env: WipeEnv, config: LeakConfig, seed: int) -> Iterator[tuple[Any, ...]]:
    wanted_N = float(np.random.default_rng([seed, 5]).uniform(*PRESS_RANGE_N))
    expert = WipeExpert(settings=replace(AGAINST_PULL, press_N=wanted_N))
    past: list[tuple[np.ndarray, np.ndarray, np.ndarray | None]] = []
    for step, target in enumerate(walk(env, expert, seed), start=1):
        # Only while the eraser sweeps and presses: a hand off the board presses nothing, and any camera shows that.
        looks = expert.phase == "wipe" and env.sim.press_N > TOUCHING_N and step % HISTORY_STEP == 0
        pixels = env.observe()["pixels"] if looks else {}
        past.append((env.state, target, _pictures(pixels, config.image_side) if looks else None))
        frames = past[-1 - (PAST - 1) * HISTORY_STEP :: HISTORY_STEP]
        pictures = [frame[2] for frame in frames[-FRAMES:] if frame[2] is not None]
        if looks and step % (EVERY * HISTORY_STEP) == 0 and len(frames) == PAST and len(pictures) == FRAMES:
            pose, command = (np.concatenate([frame[part] for frame in frames]) for part in (0, 1))
            touch = np.concatenate([described_now(pixels, finger) for finger in FINGERS])
            yield pose, command, touch, np.concatenate(pictures), env.sim.press_N


def _pictures(pixels: dict[str, np.ndarray], side: int) -> np.ndarray:
    small = [cv2.resize(pixels[name], (side, side), interpolation=cv2.INTER_AREA) for name in CAMERAS]
    return np.concatenate(small, axis=-1).transpose(2, 0, 1)  # (6, S, S)


def measure(samples: Samples, cnn_steps: int) -> dict[str, float]:
    train = samples.scene < round(2 / 3 * (samples.scene.max() + 1))
    known = np.hstack([samples.pose, samples.command])
    flat = {
        "pose": samples.pose,
        "pose and own moves": np.hstack([samples.pose, samples.moves]),
        "pose and own targets": known,
        "touch": samples.touch,
        "touch and pose": np.hstack([samples.touch, samples.pose]),
    }
    found = {}
    for name, inputs in flat.items():
        trees = HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, random_state=0)
        trees.fit(inputs[train], samples.press_N[train])
        found[name] = float(r2_score(samples.press_N[~train], trees.predict(inputs[~train])))
    for name, beside in (("cameras and pose", samples.pose), ("cameras, pose and own targets", known)):
        predicted = _cnn(samples, beside, train, cnn_steps)
        found[name] = float(r2_score(samples.press_N[~train], predicted))
    return found


def _cnn(samples: Samples, beside: np.ndarray, train: np.ndarray, steps: int) -> np.ndarray:
    """Train a small CNN on cameras and (N, F) numbers, and return what it predicts for the unseen scenes."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = PressCNN(samples.cameras.shape[1], beside.shape[1])
    mean, sd = samples.press_N[train].mean(), samples.press_N[train].std()
    center, spread = beside[train].mean(axis=0), beside[train].std(axis=0) + 1e-6
    numbers = torch.from_numpy((beside - center) / spread).float()
    press = torch.from_numpy((samples.press_N - mean) / sd).float()
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3, weight_decay=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    rng, known = np.random.default_rng(0), np.flatnonzero(train)
    for _ in tqdm(range(steps), desc="CNN"):
        rows = rng.choice(known, 64)
        loss = (model(samples.cameras[rows], numbers[rows]) - press[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        predicted = [
            model(samples.cameras[rows], numbers[rows])
            for rows in np.array_split(np.flatnonzero(~train), 20)
            if len(rows)
        ]
    return torch.cat(predicted).numpy() * sd + mean


class PressCNN(nn.Module):
    """Three strided convolutions over stacked frames, joined by numbers."""

    def __init__(self, channels: int, numbers: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in ((channels, 24), (24, 32), (32, 48)):
            layers += [nn.Conv2d(before, after, 5, stride=2, padding=2), nn.GELU()]
        self.look = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(4), nn.Flatten())
        self.answer = nn.Sequential(nn.Linear(48 * 16 + numbers, 96), nn.GELU(), nn.Linear(96, 1))

    def forward(self, cameras: np.ndarray, numbers: torch.Tensor) -> torch.Tensor:
        """Return (B,) press in units of its spread from (B, C, S, S) uint8 pictures and (B, F) numbers."""
        seen = self.look(torch.from_numpy(cameras).float() / 255 - 0.5)
        return self.answer(torch.cat([seen, numbers], dim=1))[:, 0]


def verdict(found: dict[str, float]) -> str:
    """Say in a sentence whether the scene leaks, or whether the check proves nothing."""
    touch = found["touch and pose"]
    if touch < TOUCH_FLOOR:
        return f"proves nothing: even touch reads the press at R² {touch:.2f} only"
    blind = max((name for name in found if "touch" not in name), key=lambda name: found[name])
    word = "no leak" if found[blind] < LEAK_LIMIT else "LEAK"
    return f"{word}: R² {found[blind]:.2f} without touch ({blind}), {touch:.2f} with it"


@command(LeakConfig)
def main(config: LeakConfig) -> None:
    one_thread()
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


if __name__ == "__main__":
    sys.exit(main())
