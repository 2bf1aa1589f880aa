"""Run one scripted episode on the fast path: no rendering, stop once the script has nothing left to do."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lerobot_env_uniforce_wiping.env import WipeEnv
from uniforce_vtla.evaluation.episode import EpisodeResult

IDLE_STEPS = 15  # steps in phase "done" after which nothing more can happen


class Script(Protocol):
    """The expert or a blind script."""

    @property
    def phase(self) -> str:
        """What it is doing."""

    def reset(self, env: WipeEnv) -> None:
        """Start a new episode."""

    def act(self, env: WipeEnv) -> np.ndarray:
        """Return the next absolute target (5,)."""


def run_script(env: WipeEnv, script: Script, seed: int) -> EpisodeResult:
    """Return the score of one episode."""
    env.start(seed)
    script.reset(env)
    done, idle = False, 0
    while not done and idle < IDLE_STEPS:
        done = env.advance(script.act(env))
        idle += script.phase == "done"
    return env.result()
