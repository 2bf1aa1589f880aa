"""Readings of a frozen head on a finger of the scene while the expert wipes, by the true wrench or by that head."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import SensorError
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent import POOL, Latent

EVERY = 4  # steps between two readings
GRIPPED_N = 1.0  # the eraser is held

# reference, current (480, 640) uint8 → (F,)
Features = Callable[[np.ndarray, np.ndarray, Finger], np.ndarray]


@dataclass(frozen=True)
class Readings:
    """n moments in which the eraser was held."""

    latent: Latent  # (n, P, L) pooled, canonical frame
    truth_N: np.ndarray  # (n, 3) force on the pad, canonical frame
    before_N: np.ndarray  # (n, 3) the same a step earlier, which is what a worn sensor shows
    press_N: np.ndarray  # (n,) of the eraser on the board
    refused: int  # frames that the canonicalizer refused
    also: dict[str, np.ndarray]  # name → (n, F) of other features of the same frames

    @property
    def features(self) -> dict[str, np.ndarray]:
        """Name → (n, F): the tokenizer's latents and the other features."""
        return {"tokenizer": self.latent.numpy().reshape(len(self.latent), -1), **self.also}


@cache
def shipped_reader() -> tuple[Tokenizer, ForceHead]:
    """Return the shipped tokenizer and the head of the demonstrations' sensor.

    Workers find it by name: a cached function of a program that runs as ``__main__`` can't be sent to them.
    """
    return Tokenizer.from_pretrained(), ForceHead.from_pretrained()


def encode_now(env: WipeEnv, finger: Finger, tokenizer: Tokenizer) -> Latent:
    """Return the (1, P, L) pooled latent of a finger; SensorError where its frame is refused."""
    return encode_pair(tokenizer, *env.marker_pair(finger), finger)


def encode_pair(
    tokenizer: Tokenizer, reference: np.ndarray, current: np.ndarray, finger: Finger
) -> Latent:
    """Return the (1, P, L) pooled latent of (480, 640) uint8 images."""
    return tokenizer.pooled(reference, current, finger)


def read_scenes(
    level: str,
    finger: Finger,
    sensor: str,
    seeds: range,
    tokenizer: Tokenizer,
    also: Mapping[str, Features] = {},
) -> Readings:
    """Let the expert wipe by the true wrench with ``sensor`` on ``finger``, and read it every few steps.

    Raises SensorError: the reference of a scene's unit is refused.
    """
    worn: dict[str, Any] = {f"{finger}_sensor": sensor}
    env, latents, truth, before, press, refused = (
        WipeEnv(level, drawn=(finger,), **worn),
        [],
        [],
        [],
        [],
        0,
    )
    others: dict[str, list[np.ndarray]] = {name: [] for name in also}
    for seed in seeds:
        now: np.ndarray = np.zeros(3)
        for step, _ in enumerate(walk(env, WipeExpert(), seed)):
            earlier, now = now, env.true_wrench()[finger][:3]
            if step % EVERY or now[2] < GRIPPED_N:
                continue
            try:
                pair = env.marker_pair(finger)
            except SensorError:
                refused += 1
                continue
            latents.append(encode_pair(tokenizer, *pair, finger))
            for name, features in also.items():
                others[name].append(features(*pair, finger))
            truth.append(now)
            before.append(earlier)
            press.append(env.sim.press_N)
    found = torch.cat(latents) if latents else torch.zeros(0, POOL**2, tokenizer.config.latent)
    latent = Latent.of(found.as_subclass(torch.Tensor), tokenizer.hash)
    now_N, before_N = (np.array(one).reshape(-1, 3) for one in (truth, before))
    found_also = {name: np.array(values) for name, values in others.items()}
    return Readings(latent, now_N, before_N, np.array(press), refused, found_also)


class ReadsWorn(WipeExpert):
    """The expert's law on what the head reads of one worn finger; a refused frame repeats the reading before it.

    Where the finger wears a ``calibration``, of what the head reads after it.
    """

    def __init__(
        self,
        finger: Finger,
        tokenizer: Tokenizer,
        head: ForceHead,
        calibration: Calibration | None = None,
    ) -> None:
        super().__init__(fingers=finger)
        self._finger, self._tokenizer, self._head = finger, tokenizer, head
        self._calibration = calibration
        self._read = np.zeros(3)

    def reset(self, env: WipeEnv) -> None:
        self._read = np.zeros(3)
        super().reset(env)

    def _feel(self, env: WipeEnv) -> dict[Finger, np.ndarray]:
        with suppress(SensorError):  # a frame late; the score shows what it costs
            latent = encode_now(env, self._finger, self._tokenizer)
            worn = self._calibration
            force_N = self._head(latent) if worn is None else worn.scaled(self._head(worn(latent)))
            self._read = force_N[0].numpy()
        return {self._finger: self._read}
