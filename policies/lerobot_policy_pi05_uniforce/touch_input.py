"""What each touch slot feels, gathered from a batch: cached latents, marker images, or a control in their place."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from uniforce_vtla.errors import RolloutError, expected
from uniforce_vtla.keys import descriptor_key, latent_key, marker_pair_key, tactile_key, wrench_key
from uniforce_vtla.probes.plain_touch import DESCRIPTOR_SIZE, PAIR_SIDE, descriptors, marker_pairs

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
    from lerobot_policy_pi05_uniforce.tactile_encoder import TactileEncoder

logger = logging.getLogger(__name__)

WRENCH_SIZE = 4  # fx, fy, fz in N, torsion in Nmm
PLAIN = {
    "descriptor": (descriptor_key, descriptors),
    "marker_pair": (marker_pair_key, marker_pairs),
}  # controls


def touch_shape(config: PI05UniforceConfig) -> tuple[int, int]:
    """Return rows and numbers per row of a slot's input."""
    shapes = {
        "wrench": (1, WRENCH_SIZE),
        "descriptor": (1, DESCRIPTOR_SIZE),
        "marker_pair": (2, PAIR_SIDE**2),  # flat: what has four axes counts as a camera
    }
    return shapes.get(config.touch_input, (config.tokens_per_slot, config.latent_size))


class TouchInput:
    """Turn a batch into one (B, rows, numbers) tensor (``touch_shape``) and one (B,) mask per slot.

    Args:
        config: slots, fingers after swap, what to do on sensor loss, dropout.
        encoder: frozen tokenizer, or None where the input is a wrench.
    """

    def __init__(self, config: PI05UniforceConfig, encoder: TactileEncoder | None) -> None:
        self.config = config
        self.encoder = encoder
        self.muted = False  # every slot masked: the control that takes touch away from a trained policy
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
        if self.muted:
            masks = [torch.zeros_like(mask) for mask in masks]
        return touches, self._dropout(masks) if training else masks

    def _feel(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor | None:
        if self.config.touch_input == "wrench":
            value = self._take(batch, wrench_key(slot))
            return None if value is None else value.to(device, torch.float32)[:, None]  # (B, 1, 4)
        if self.config.touch_input in PLAIN:
            return self._plain(batch, slot, device)
        if latent_key(slot) in batch:
            latent = batch[latent_key(slot)].to(device, torch.float32)
            return latent.reshape(len(latent), -1, self.config.latent_size)  # (B, K, latent)
        return self._encode(batch, slot, device)

    def _plain(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor | None:
        """Return a control's input, (B, rows, numbers): cached, or computed from the marker images."""
        key, compute = PLAIN[self.config.touch_input]
        value = batch.get(key(slot))
        if value is None:
            pair = self._pair(batch, slot)
            if pair is None:
                return None
            finger = self.config.finger_by_slot()[slot]
            reference, current = (_grey(images) for images in pair)
            rows = [compute(b, c[None], finger) for b, c in zip(reference, current, strict=True)]
            value = torch.from_numpy(np.concatenate(rows))
        scale = 255 if value.dtype == torch.uint8 else 1
        return (value.to(device, torch.float32) / scale).reshape(len(value), *touch_shape(self.config))

    def _pair(self, batch: dict[str, Tensor], slot: str) -> tuple[Tensor, Tensor] | None:
        """Return a slot's reference and current marker images, or None where one is lost."""
        finger = self.config.finger_by_slot()[slot]
        reference = self._take(batch, tactile_key(finger, reference=True))
        current = self._take(batch, tactile_key(finger))
        return None if reference is None or current is None else (reference, current)

    def _encode(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor | None:
        pair = self._pair(batch, slot)
        if pair is None or self.encoder is None:
            return None
        reference, current = pair
        finger = self.config.finger_by_slot()[slot]
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
        return torch.zeros(size, *touch_shape(self.config), device=device)

    def _dropout(self, masks: list[Tensor]) -> list[Tensor]:
        share = self.config.hidden_share
        return [mask & (torch.rand_like(mask, dtype=torch.float32) >= share) for mask in masks]


def _grey(images: Tensor) -> np.ndarray:
    """Return (B, H, W) uint8 from (B, 3, H, W) or (B, H, W) marker images in [0, 1]."""
    grey = images[:, 0] if images.ndim == 4 else images
    return (grey.detach().cpu() * 255).round().to(torch.uint8).numpy()


def _batch_size(batch: dict[str, Tensor]) -> int:
    return len(next(v for k, v in batch.items() if k.startswith("observation.") and isinstance(v, Tensor)))
