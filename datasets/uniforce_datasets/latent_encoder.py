"""Pooled latents of an episode's marker images, by whatever encodes them."""

from pathlib import Path
from typing import Protocol

import numpy as np

from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer, pool_latent


class LatentEncoder(Protocol):
    """What a training view asks of an encoder."""

    @property
    def hash(self) -> str:
        """Identity of the weights; policies refuse latents of another one."""

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """Return (B, K·latent) float32 from a (H, W) reference and (B, H, W) images as the sensor saw them."""


class PooledTokenizer:
    """A frozen tokenizer with its latents pooled to grid × grid.

    Args:
        tokenizer: it, the folder it is in, or None for the shipped one.
        grid: cells per side.
    """

    def __init__(self, tokenizer: Tokenizer | str | Path | None, grid: int) -> None:
        found = tokenizer if isinstance(tokenizer, Tokenizer) else Tokenizer.from_pretrained(tokenizer or None)
        self._tokenizer, self._grid, self.hash = found, grid, found.hash

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """See ``LatentEncoder``."""
        latent = self._tokenizer.encode(reference[None], current, finger)  # (B, P, latent)
        return pool_latent(latent, self._grid).flatten(1).numpy()  # (B, K·latent)
