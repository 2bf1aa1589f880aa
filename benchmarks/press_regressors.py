"""Does anything but touch predict the press?  Regressors that may look at everything a policy sees, except touch.

They should fail where touch succeeds. Trees read three frames of state, a small CNN three frames of both cameras;
the check counts only if the same trees read the press well from touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.metrics import r2_score
from torch import nn
from tqdm import tqdm

LEAK_LIMIT, TOUCH_FLOOR = 0.3, 0.75  # R²
FRAMES = 3  # of history in a sample


@dataclass(frozen=True)
class Samples:
    """Moments of wiping: (N, …) inputs, what was pressed, and which scene each is from."""

    state: np.ndarray  # (N, 15): measured x, y, z, yaw, width, three frames
    command: np.ndarray  # (N, 15): the targets issued, three frames; a policy knows its own
    touch: np.ndarray  # (N, 12): hand descriptors of both fingers now
    cameras: np.ndarray  # (N, 18, S, S) uint8: two cameras, three frames
    press_N: np.ndarray  # (N,)
    scene: np.ndarray  # (N,)

    @property
    def moves(self) -> np.ndarray:
        """Return (N, 10): how the targets changed between the three frames; the targets themselves predict a force."""
        frames = self.command.reshape(len(self.command), FRAMES, -1)
        return np.diff(frames, axis=1).reshape(len(frames), -1)


def measure(samples: Samples, cnn_steps: int) -> dict[str, float]:
    """Return R² of the press on unseen scenes, for each input."""
    train = samples.scene < round(2 / 3 * (samples.scene.max() + 1))
    flat = {
        "state": samples.state,
        # the inputs of a policy without touch
        "state and own moves": np.hstack([samples.state, samples.moves]),
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
    blind = max(found["state"], found["state and own moves"], found["cameras and state"])
    word = "no leak" if blind < LEAK_LIMIT else "LEAK"
    return f"{word}: R² {blind:.2f} without touch, {found['touch and state']:.2f} with it"
