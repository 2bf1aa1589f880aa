"""What each touch slot feels, gathered from a batch: cached latents, marker images, or the true wrench."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from uniforce_vtla.errors import RolloutError, expected
from uniforce_vtla.keys import latent_key, tactile_key, wrench_key

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
    from lerobot_policy_pi05_uniforce.tactile_encoder import TactileEncoder

logger = logging.getLogger(__name__)

WRENCH_SIZE = 4  # fx, fy, fz in N, torsion in Nmm


class TouchInput:
    """Turn a batch into one (B, K or 1, input_size) tensor and one (B,) mask per slot.

    Args:
        config: slots, fingers after swap, what to do on sensor loss, dropout.
        encoder: frozen tokenizer, or None where the input is a wrench.
    """

    def __init__(self, config: PI05UniforceConfig, encoder: TactileEncoder | None) -> None:
        self.config = config
        self.encoder = encoder
        self._logged: set[str] = set()

    def reset(self) -> None:
        """Forget cached references: the next episode takes its own."""
        if self.encoder is not None:
            self.encoder.forget_references()

    def gather(self, batch: dict[str, Tensor], device: torch.device, training: bool) -> tuple[list, list]:
        """Return the slots' tensors and masks, in slot order.

        Raises:
            RolloutError: a declared input is missing or not finite, and ``on_sensor_loss`` is "error".
        """
        size = _batch_size(batch)
        touches, masks = [], []
        for slot in self.config.slots:
            touch = self._feel(batch, slot, device)
            if touch is None:
                touch = self._nothing(size, device)
                masks.append(torch.zeros(size, dtype=torch.bool, device=device))
            else:
                masks.append(self._present(slot, touch))
            touches.append(touch.nan_to_num())
        return touches, self._dropout(masks) if training else masks

    def _feel(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor | None:
        if self.config.touch_input == "wrench":
            value = self._take(batch, wrench_key(slot))
            return None if value is None else value.to(device, torch.float32)[:, None]  # (B, 1, 4)
        if latent_key(slot) in batch:
            latent = batch[latent_key(slot)].to(device, torch.float32)
            return latent.reshape(len(latent), -1, self.config.latent_size)  # (B, K, latent)
        return self._encode(batch, slot, device)

    def _encode(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor | None:
        finger = self.config.finger_by_slot()[slot]
        reference = self._take(batch, tactile_key(finger, reference=True))
        current = self._take(batch, tactile_key(finger))
        if reference is None or current is None or self.encoder is None:
            return None
        return self.encoder.feel(slot, finger, reference.to(device), current.to(device))  # (B, K, latent)

    def _take(self, batch: dict[str, Tensor], key: str) -> Tensor | None:
        if key in batch:
            return batch[key]
        self._lost(expected(key, "a tensor in the observation", "none", "Check the sensor of that finger."))
        return None

    def _present(self, slot: str, touch: Tensor) -> Tensor:
        finite = torch.isfinite(touch).flatten(1).all(dim=1)  # (B,)
        if not bool(finite.all()):
            self._lost(expected(slot, "finite numbers", "NaN or inf", "Check the sensor or the dataset."))
        return finite

    def _lost(self, message: str) -> None:
        if self.config.on_sensor_loss == "error":
            raise RolloutError(message)
        if message not in self._logged:
            self._logged.add(message)
            logger.warning("on_sensor_loss=mask: going on without touch. %s", message)

    def _nothing(self, size: int, device: torch.device) -> Tensor:
        width = WRENCH_SIZE if self.config.touch_input == "wrench" else self.config.latent_size
        return torch.zeros(size, self.config.tokens_per_slot, width, device=device)

    def _dropout(self, masks: list[Tensor]) -> list[Tensor]:
        if len(masks) < 2 or self.config.touch_dropout <= 0:
            return masks
        return [
            mask & (torch.rand_like(mask, dtype=torch.float32) >= self.config.touch_dropout) for mask in masks
        ]


def _batch_size(batch: dict[str, Tensor]) -> int:
    return len(next(v for k, v in batch.items() if k.startswith("observation.") and isinstance(v, Tensor)))
