"""The wiping scene with a disturbance of arm or board; the sensors are as they were."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lerobot_env_uniforce_wiping import SceneParams, WipeEnv
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ

PUSH_EVERY = round(2 * CONTROL_HZ)
PUSH_STEPS = round(0.2 * CONTROL_HZ)


@dataclass(frozen=True)
class Disturbance:
    """Differences from the usual episode."""

    scene: Callable[[SceneParams], SceneParams] = lambda scene: scene
    late_steps: int = 0  # actions are executed so much later
    push_N: float = 0.0  # on the hand, for .2 s every 2 s, in a direction drawn each time


def late(delay_ms: float) -> Disturbance:
    """Return actions that are late by whole control steps of 33 ms."""
    return Disturbance(late_steps=round(delay_ms / 1000 * CONTROL_HZ))


def pushed(push_N: float) -> Disturbance:
    """Return pushes on the hand."""
    return Disturbance(push_N=push_N)


def rougher(factor: float) -> Disturbance:
    """Return a board whose unevenness is multiplied."""

    def change(scene: SceneParams) -> SceneParams:
        usual = scene.level.uneven
        assert usual is not None, "level touch has an uneven board"
        more = replace(usual, sd_m=usual.sd_m * factor)
        return replace(scene, level=replace(scene.level, uneven=more))

    return Disturbance(scene=change)


class DisturbedEnv(WipeEnv):
    """The wiping scene with a disturbance; everything else as ``WipeEnv``."""

    def __init__(self, disturbance: Disturbance, *usual: Any, **options: Any) -> None:
        super().__init__(*usual, **options)
        self._disturbance = disturbance

    def scene_of(self, seed: int) -> SceneParams:
        return self._disturbance.scene(super().scene_of(seed))

    def start(self, seed: int) -> None:
        """Build the scene of ``seed``."""
        super().start(seed)
        self._waiting: deque[np.ndarray] = deque()
        self._rng = np.random.default_rng([seed, 47])

    def advance(self, action: np.ndarray) -> bool:
        """Take one step, late and pushed as the disturbance says."""
        self._waiting.append(action)
        due = self.sim.target.copy()
        if len(self._waiting) > self._disturbance.late_steps:
            due = self._waiting.popleft()
        self._push()
        return super().advance(due)

    def _push(self) -> None:
        step = self._steps % PUSH_EVERY
        if step == 0:
            direction = self._rng.standard_normal(3)
            self._next_push_N = self._disturbance.push_N * direction / np.linalg.norm(direction)
        self.sim.push_N = np.zeros(3)
        if step >= PUSH_EVERY - PUSH_STEPS:
            self.sim.push_N = self._next_push_N
