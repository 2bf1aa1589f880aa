"""Controls in place of touch: the true wrench, a hand-made descriptor, or marker images through a CNN."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.touch.sensors import load_calibrations
from lerobot_policy_pi05_uniforce.touch.tokens import ForceTokens
from lerobot_policy_pi05_uniforce.touch.touch_input import TouchInput, marker_images, taken
from uniforce_vtla.keys import descriptor_key, marker_pair_key, wrench_key
from uniforce_vtla.tokenizer.plain_touch import (
    DESCRIPTOR_SIZE,
    PAIR_SIDE,
    descriptors,
    marker_pairs,
)

# N, N, N, Nmm: a firm wipe's shear, press and torsion become ~1
WRENCH_SCALE = (5.0, 5.0, 10.0, 100.0)
SHAPES = {
    "newtons": (1, 3),  # fx, fy, fz in N
    "wrench": (1, len(WRENCH_SCALE)),  # and torsion in Nmm
    "descriptor": (1, DESCRIPTOR_SIZE),
    "marker_pair": (2, PAIR_SIDE**2),  # rows of pixels
}
FROM_IMAGES = {
    "descriptor": (descriptor_key, descriptors),
    "marker_pair": (marker_pair_key, marker_pairs),
}


class ControlInput(TouchInput):
    """Reads a control's input: cached, from the simulator, or computed from the marker images.

    A descriptor computed now is mapped by its finger's alignment, as latents are by a calibration.
    """

    def __init__(self, config: PI05UniforceConfig) -> None:
        kind = config.touch.input
        aligned = load_calibrations(config, SHAPES[kind], kind) if kind == "descriptor" else None
        super().__init__(config, SHAPES[kind])
        self._alignment = aligned or {}

    def to(self, device: torch.device) -> None:
        """Move the alignments."""
        for calibration in self._alignment.values():
            calibration.map.to(device)

    def read(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor:
        """Return (B, rows, numbers) of a slot; RolloutError where its sensor is lost."""
        if self.config.touch.input == "wrench":
            value = taken(batch, wrench_key(slot))
        else:
            key, compute = FROM_IMAGES[self.config.touch.input]
            value = (
                batch[key(slot)]
                if key(slot) in batch
                else self._computed(compute, batch, slot, device)
            )
        scale = 255 if value.dtype == torch.uint8 else 1
        return (value.to(device, torch.float32) / scale).reshape(len(value), *self.shape)

    def _computed(
        self, compute: Callable, batch: dict[str, Tensor], slot: str, device: torch.device
    ) -> Tensor:
        finger = self.config.finger_by_slot()[slot]
        references, currents = marker_images(batch, finger)
        rows = []
        for reference, current in zip(_uint8(references), _uint8(currents), strict=True):
            rows.append(compute(reference, current[None], finger))
        found = torch.from_numpy(np.concatenate(rows))
        if finger not in self._alignment:
            return found
        return self._alignment[finger].map(found.reshape(-1, *self.shape).to(device))


def _uint8(images: Tensor) -> np.ndarray:
    return (images.detach().cpu() * 255).round().to(torch.uint8).numpy()


class MarkerPairTokens(nn.Module):
    """Marker images through a small CNN learnt with the policy, instead of the frozen tokenizer.

    Args:
        config: slots and tokens per slot.
        width: of a token.
    """

    def __init__(self, config: PI05UniforceConfig, width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise((2, 32, 64, width)):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.GELU()]
        pool = nn.AdaptiveAvgPool2d(config.latent_grid)
        self.cnn = nn.Sequential(*layers, pool, nn.Conv2d(width, width, 1))
        self.cell_embedding = nn.Parameter(0.5 * torch.randn(config.tokens_per_slot, width))
        self.slot_embedding = nn.Parameter(0.5 * torch.randn(len(config.slots), width))
        self.gain = nn.Parameter(torch.ones(1))  # not a scalar: FSDP shards none

    def forward(self, pair: Tensor, slot: int) -> Tensor:
        """Map (B, 2, S²) reference and current in [0, 1] to (B, K, D)."""
        side = math.isqrt(pair.shape[-1])
        hidden = self.cnn(pair.unflatten(-1, (side, side))).flatten(2).transpose(1, 2)  # (B, K, D)
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]
        return self.gain * nn.functional.rms_norm(hidden, hidden.shape[-1:])


def control_tokens(config: PI05UniforceConfig, width: int) -> ForceTokens | MarkerPairTokens:
    """Return the tokens of a policy with this control."""
    if config.touch.input == "marker_pair":
        return MarkerPairTokens(config, width)
    tokens = ForceTokens(config, SHAPES[config.touch.input], width)
    if config.touch.input in ("wrench", "newtons"):
        tokens.input_scale.copy_(torch.tensor(WRENCH_SCALE[: tokens.input_scale.numel()]))
    return tokens
