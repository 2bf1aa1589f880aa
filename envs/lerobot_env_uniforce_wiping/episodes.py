"""Scripted episodes on the fast path: nothing is rendered unless the caller observes."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from lerobot_env_uniforce_wiping.env import WipeEnv
from uniforce_vtla.errors import RobotError
from uniforce_vtla.evaluation.episode import EpisodeResult

IDLE_STEPS = 15  # steps in phase "done" after which nothing more can happen


class Script(Protocol):
    """The expert, or a control of the gates."""

    @property
    def phase(self) -> str:
        """Current phase."""

    def reset(self, env: WipeEnv) -> None:
        """Start a new episode."""

    def act(self, env: WipeEnv) -> np.ndarray:
        """Return the next absolute target (5,)."""


def walk(env: WipeEnv, script: Script, seed: int) -> Iterator[np.ndarray]:
    """Run the scene of ``seed`` to its end; yield each (5,) target after it was executed."""
    env.start(seed)
    script.reset(env)
    done = False
    while not done:
        target = script.act(env)
        done = env.advance(target)
        yield target


def run_script(env: WipeEnv, script: Script, seed: int) -> EpisodeResult:
    """Return the score of one episode; it is aborted where the hand loses the tool.

    Raises RobotError: any other fault of the hand.
    """
    idle = 0
    try:
        for _ in walk(env, script, seed):
            idle += script.phase == "done"
            if idle >= IDLE_STEPS:
                break
    except RobotError as error:
        if error.fault != "grasp_lost":
            raise
        return replace(env.result(), outcome="aborted")
    return env.result()
