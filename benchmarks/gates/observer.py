"""A recurrent observer of press: what a policy without touch could remember of its inputs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.expert import Contact

HIDDEN, WINDOW_STEPS, BATCH, EPOCHS = 64, 120, 32, 40
HELD_OUT = 0.1  # of the episodes, for the R² that is reported


def seen(env: WipeEnv, ink: bool) -> np.ndarray:
    """Return (11,): the measured pose, the command's distance, the ink left (0 without)."""
    state = env.state.astype(np.float64)
    return np.array(
        [*state, *(env.sim.target - state), env.sim.ink.residual if ink else 0.0], np.float32
    )


class PressObserver(nn.Module):
    """GRU over what is seen; returns the press in newtons."""

    def __init__(self, mean: torch.Tensor, spread: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("spread", spread)
        self.gru = nn.GRU(len(mean), HIDDEN, batch_first=True)
        self.head = nn.Linear(HIDDEN, 1)

    def forward(
        self, x: torch.Tensor, state: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, T) N and the next state, given (B, T, 11)."""
        out, state = self.gru((x - self.mean) / self.spread, state)
        return self.head(out)[..., 0], state


def train_observer(
    episodes: list[tuple[np.ndarray, np.ndarray]], seed: int = 0
) -> tuple[PressObserver, float]:
    """Return an observer trained on (T, 11), (T,) N per episode, and its R² on those held out."""
    torch.manual_seed(seed)
    rng, held = np.random.default_rng(seed), max(1, round(HELD_OUT * len(episodes)))
    shown, kept = episodes[held:], episodes[:held]
    every = torch.from_numpy(np.concatenate([x for x, _ in shown]))
    model = PressObserver(every.mean(dim=0), every.std(dim=0).clamp(min=1e-6))
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    steps = EPOCHS * len(shown) * 6 // BATCH
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in tqdm(range(steps), desc="observer of press", leave=False):
        x, y = (
            torch.from_numpy(np.stack(part)) for part in zip(*_windows(rng, shown), strict=True)
        )
        error = ((model(x)[0] - y) ** 2).mean()
        optimizer.zero_grad()
        error.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        schedule.step()
    model.eval()
    return model, r2_on(model, kept)


def _windows(
    rng: np.random.Generator, episodes: list[tuple[np.ndarray, np.ndarray]]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Draw windows that begin with an episode, half of them, or anywhere in it."""
    drawn = []
    for index in rng.integers(len(episodes), size=BATCH):
        x, y = episodes[index]
        start = int(rng.integers(max(len(x) - WINDOW_STEPS, 1)))
        drawn.append((x[start : start + WINDOW_STEPS], y[start : start + WINDOW_STEPS]))
    shortest = min(len(x) for x, _ in drawn)
    return [(x[:shortest], y[:shortest]) for x, y in drawn]


@torch.no_grad()
def r2_on(model: PressObserver, episodes: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Return R² of the press over whole episodes, while it presses."""
    pairs = [(model(torch.from_numpy(x)[None])[0][0].numpy(), y) for x, y in episodes]
    said, truth = (np.concatenate(part) for part in zip(*pairs, strict=True))
    pressing = truth > 0.5
    return float(1 - ((said - truth)[pressing] ** 2).mean() / truth[pressing].var())


class Observed:
    """Press as the observer works it out; grip is read."""

    def __init__(self, path: Path, ink: bool) -> None:
        self._model, self._ink, self._state = load_observer(path), ink, None

    @torch.no_grad()
    def __call__(self, read: Contact, env: WipeEnv, phase: str) -> Contact:
        """Return the grip that is read and the press that is worked out, step by step."""
        x = torch.from_numpy(seen(env, self._ink))[None, None]
        press_N, self._state = self._model(x, self._state)
        return replace(read, press_N=float(press_N[0, 0]))


def load_observer(path: Path) -> PressObserver:
    weights = torch.load(path, weights_only=True)
    model = PressObserver(weights["mean"], weights["spread"])
    model.load_state_dict(weights)
    return model.eval()
