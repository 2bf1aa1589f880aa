"""Controls at rollout time: the same checkpoint with its touch taken away, or with another scene's.

Both ask whether the policy uses touch: masked touch carries nothing, shuffled touch is plausible for the phase of the
task but of another scene.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from tqdm import tqdm

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.rollout import Controller
from uniforce_vtla.keys import TACTILE_NAMES

DONOR_SEED = 50_000  # scenes that are neither trained on nor scored
DONORS = 6  # expert episodes that lend their touch
EVERY = 5  # steps between two frames kept of a donor

Donated = dict[str, np.ndarray]  # stream → (H, W) bool, packed along the last axis


def controlled(controller: PolicyController, control: str, env: WipeEnv) -> Controller:
    """Return the controller under a control, ``masked`` or ``shuffled``; "" leaves it as it is.

    Raises:
        ContractError: an unknown control.
    """
    if control == "shuffled":
        return ShuffledTouch(controller, donated_touch(env.level.name, env.sensors))
    if control not in ("", "masked"):
        raise ContractError(expected("control", "masked | shuffled", repr(control), "Name one."))
    controller.policy.touch.masked |= control == "masked"
    return controller


def donated_touch(level: str, sensors: dict[str, str], donors: int = DONORS) -> dict[int, list[Donated]]:
    """Return marker images of expert episodes on other scenes, by phase of the task."""
    env, expert = WipeEnv(level, sensors["left"], sensors["right"]), WipeExpert()
    bank: dict[int, list[Donated]] = {}
    for seed in tqdm(range(DONOR_SEED, DONOR_SEED + donors), desc="donated touch", disable=None):
        for step, _ in enumerate(walk(env, expert, seed), start=1):
            if step % EVERY == 0 or env.phase not in bank:
                pixels = env.observe()["pixels"]
                packed = {name: np.packbits(pixels[name][..., 0] > 0, axis=-1) for name in TACTILE_NAMES}
                bank.setdefault(env.phase, []).append(packed)
    return bank


class ShuffledTouch:
    """A controller that gets, at every look, the touch of a random moment of another scene in the same phase."""

    def __init__(self, inner: Controller, bank: dict[int, list[Donated]]) -> None:
        self._inner, self._bank = inner, bank
        self._env: Any = None

    def reset(self, env: Any) -> None:
        """Start an episode; the scene's seed decides which touch it gets."""
        self._env = env
        self._rng = np.random.default_rng([env.scene.seed, 31])
        self._inner.reset(env)

    def facts(self) -> dict[str, float]:
        """Return the inner controller's facts."""
        return self._inner.facts()

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the inner controller's chunk for this observation with touch exchanged."""
        bank = self._bank[max(phase for phase in self._bank if phase <= self._env.phase)]
        donated = bank[int(self._rng.integers(len(bank)))]
        grey = {name: np.unpackbits(image, axis=-1) * np.uint8(255) for name, image in donated.items()}
        exchanged = {
            name: np.repeat(image[..., None], 3, axis=-1) for name, image in grey.items()
        }  # (H, W, 3)
        return self._inner.chunk(observation | {"pixels": observation["pixels"] | exchanged}, task)
