"""Auxiliary head of training: the latents when the next chunk begins; ``uniforce share`` leaves it out."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import next_latent_key


class NextForce(nn.Module):
    """Predict every slot's ``size`` numbers, its pooled latents, from the chunk's hidden states."""

    def __init__(self, width: int, slots: tuple[str, ...], size: int) -> None:
        super().__init__()
        self._slots, self._size = slots, size
        self.head = nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, len(slots) * size))

    def forward(self, hidden: Tensor, batch: dict[str, Tensor], mean: Tensor, scale: Tensor) -> Tensor:
        """Return the (B,) mean squared error in units of the latents' spread; 0 where the episode ends before.

        Args:
            hidden: (B, chunk, width) outputs of the action tokens.
            batch: holds ``next_latent_key(slot)``, (B, K · latent), NaN where the episode ends before.
            mean: (K, latent) of a slot's latents.
            scale: (latent,) their spread.

        Raises:
            ContractError: the batch doesn't hold what comes next.
        """
        predicted = self.head(hidden.float().mean(dim=1)).unflatten(-1, (len(self._slots), self._size))
        wanted = torch.stack([self._next(batch, slot) for slot in self._slots], dim=1).to(predicted)
        wanted = (wanted - mean.flatten()) / scale.repeat(self._size // len(scale))
        known = wanted.isfinite()
        return ((predicted - wanted.nan_to_num()).square() * known).mean(dim=(1, 2))

    def _next(self, batch: dict[str, Tensor], slot: str) -> Tensor:
        key = next_latent_key(slot)
        if key not in batch:
            do = "Train on a view (uniforce view), or set policy.touch.next_force_weight=0."
            raise ContractError(expected(key, "latents one chunk ahead", "none", do))
        return batch[key].reshape(len(batch[key]), self._size)
