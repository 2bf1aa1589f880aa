"""The cheapest test of the whole idea: does cloning use touch here, and in which action form?

A small MLP is cloned from the expert by plain regression, with and without the true wrench of both pads, and rolled
out on unseen scenes. Minutes, not hours: run it after any change to the scene, before training anything larger.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from uniforce_cli.boundary import command
from uniforce_cli.option_types import Level
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.statistics import mcnemar, wilson
from uniforce_vtla.options import Count, Names, OutFile
from uniforce_vtla.results_file import provenance, write_json

WRENCH_UNIT = np.tile([4.0, 4.0, 8.0, 40.0], 2)  # N, N, N, Nmm per finger: brings the wrench near 1
FORMS = ("target_delta", "measured_delta", "absolute")


Forms = Annotated[list[str], Names(FORMS)]


@dataclass
class TouchCheckConfig:
    """Clone the expert with and without the true wrench; write clean success of both on the same seeds.

    Example: python -m benchmarks.touch_needed level=easy rollouts=50 forms=[target_delta]
    """

    level: Level = "easy"  # locked level
    demos: Count = 50  # expert episodes from seed 0 on; only clean ones are cloned
    rollouts: Count = 50  # unseen scenes, from seed 10 000 on
    forms: Forms = field(default_factory=lambda: list(FORMS))  # what a chunk is relative to
    chunk: Count = 16  # steps predicted
    execute: Count = 6  # steps run before looking again (0.2 s at 30 Hz)
    train_steps: Count = 4000  # of 256 samples, AdamW 1e-3, cosine
    out: OutFile = "outputs/touch_check/touch_check.json"  # result file


@dataclass(frozen=True)
class Demo:
    """One expert episode: state (T, 5), scaled wrench (T, 8), action (T, 5)."""

    state: np.ndarray
    wrench: np.ndarray
    action: np.ndarray

    def targets(self, form: str, chunk: int) -> np.ndarray:
        """Return (T, chunk, 5): the next actions relative to the form's base."""
        steps = np.minimum(np.arange(len(self.action))[:, None] + np.arange(chunk), len(self.action) - 1)
        previous = np.concatenate([self.state[:1], self.action[:-1]])
        return self.action[steps] - base_of(form, previous, self.state)[:, None]


def base_of(form: str, issued: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return what a chunk is added to."""
    return {"target_delta": issued, "measured_delta": measured, "absolute": np.zeros_like(measured)}[form]


def scaled_wrench(env: WipeEnv) -> np.ndarray:
    """Return the true wrench of both pads, (8,)."""
    wrench = env.true_wrench()
    return np.concatenate([wrench[finger] for finger in FINGERS]) / WRENCH_UNIT


def collect(config: TouchCheckConfig) -> list[Demo]:
    """Return the clean ones of the expert's episodes, without rendering anything."""
    env, expert, demos = WipeEnv(config.level), WipeExpert(), []
    for seed in tqdm(range(config.demos), desc="demos"):
        env.start(seed)
        expert.reset(env)
        rows, done = [], False
        while not done:
            state, wrench, action = env.state.copy(), scaled_wrench(env), expert.act(env)
            rows.append((state, wrench, action))
            done = env.advance(action)
        if env.result().clean:
            demos.append(Demo(*(np.stack(column) for column in zip(*rows, strict=True))))
    return demos


class Clone(nn.Module):
    """Three hidden layers from state (and wrench) to a chunk; standardises by the demos."""

    def __init__(self, demos: list[Demo], form: str, touch: bool, chunk: int) -> None:
        super().__init__()
        self.form, self.touch, self.chunk = form, touch, chunk
        self.inputs = torch.tensor(np.concatenate([self._inputs(d.state, d.wrench) for d in demos])).float()
        self.targets = torch.tensor(np.concatenate([d.targets(form, chunk) for d in demos])).float()
        self.centre, self.spread = self.inputs.mean(0), self.inputs.std(0) + 1e-4
        self.middle, self.scale = self.targets.mean((0, 1)), self.targets.std((0, 1)) + 1e-6
        sizes = (self.inputs.shape[1], 256, 256, 256)
        hidden = [m for a, b in itertools.pairwise(sizes) for m in (nn.Linear(a, b), nn.GELU())]
        self.layers = nn.Sequential(*hidden, nn.Linear(256, chunk * 5))

    def _inputs(self, state: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        return np.concatenate([state, wrench], axis=-1) if self.touch else state

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(B, 5 or 13) → (B, chunk, 5) in units of the targets' spread."""
        return self.layers((inputs - self.centre) / self.spread).unflatten(1, (self.chunk, 5))

    def fit(self, steps: int) -> Clone:
        """Regress the demos' chunks."""
        optimizer = torch.optim.AdamW(self.parameters(), lr=1e-3)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        wanted = (self.targets - self.middle) / self.scale
        for _ in tqdm(range(steps), desc=f"{self.form}, {'touch' if self.touch else 'no touch'}"):
            batch = torch.randint(len(self.inputs), (256,))
            loss = (self(self.inputs[batch]) - wanted[batch]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        return self

    @torch.no_grad()
    def act(self, state: np.ndarray, wrench: np.ndarray, issued: np.ndarray) -> np.ndarray:
        """Return a (chunk, 5) run of absolute targets."""
        outputs = self(torch.tensor(self._inputs(state, wrench)).float()[None])[0]
        return base_of(self.form, issued, state) + (outputs * self.scale + self.middle).numpy()


def clean_episodes(clone: Clone, config: TouchCheckConfig) -> list[bool]:
    """Roll a clone out on unseen scenes; return clean success per seed."""
    env, clean = WipeEnv(config.level), []
    for seed in tqdm(range(10_000, 10_000 + config.rollouts), desc="rollouts"):
        env.start(seed)
        issued, done = env.state.copy(), False
        while not done:
            for action in clone.act(env.state.copy(), scaled_wrench(env), issued)[: config.execute]:
                issued, done = action, env.advance(action.astype(np.float32))
                if done:
                    break
        clean.append(bool(env.result().clean))
    return clean


def run(config: TouchCheckConfig) -> dict[str, dict]:
    """Return, per action form, k/n with and without touch and the paired test."""
    torch.manual_seed(0)
    demos, rows = collect(config), {}
    for form in config.forms:
        felt, blind = (
            clean_episodes(Clone(demos, form, touch, config.chunk).fit(config.train_steps), config)
            for touch in (True, False)
        )
        test = mcnemar(felt, blind)
        rows[form] = {"n": len(felt), "touch": sum(felt), "no_touch": sum(blind), "mcnemar_p": test.p_value}
        shares = [str(wilson(sum(clean), len(clean))) for clean in (felt, blind)]
        print(f"{form}: touch {shares[0]}; no touch {shares[1]}; McNemar p {test.p_value:.1g}")
    return rows


@command(TouchCheckConfig)
def main(config: TouchCheckConfig) -> int:
    """Entry of ``python -m benchmarks.touch_needed``."""
    torch.set_num_threads(1)
    content = {
        "what": "clean success of cloned MLPs, simulated",
        "level_hash": level_hash(LEVELS[config.level]),
    }
    path = write_json(
        Path(config.out), content | {"forms": run(config), "config": asdict(config)} | provenance()
    )
    print(f"written to {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
