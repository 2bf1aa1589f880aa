"""Training only: part of what is felt, told as another sensor would have told it.

The maps are the tokenizer's (uniforce_vtla/tokenizer/transfer.py), made from simulated grasps before any policy exists.
Nothing of this is stored in a checkpoint or runs when actions are sampled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.transfer import SensorTransfer

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig


class OtherSensors(nn.Module):
    """Replace a share of each slot's latents by what a random known sensor would have said.

    Args:
        transfer: maps between sensors.
        worn: the sensor of each slot in the training data.
        share: chance per sample; each known sensor is as likely, the slot's own kind (another unit) too.
    """

    matrix: Tensor
    offset: Tensor
    doubt: Tensor

    def __init__(self, transfer: SensorTransfer, worn: Sequence[str], share: float) -> None:
        super().__init__()
        self.share = share
        for name, maps in zip(
            ("matrix", "offset", "doubt"), zip(*map(transfer.of, worn), strict=True), strict=True
        ):
            self.register_buffer(name, torch.stack(maps), persistent=False)  # (slots, S, n, …)

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Return (B, K, latent) latents of a slot, some of them told by other sensors."""
        told = touch.flatten(1)  # (B, n)
        kinds = self.offset.shape[1]
        kind = torch.randint(kinds, (len(told),), device=told.device)
        noise = torch.randn_like(told)
        heard = told
        for k in range(kinds):
            mean = told @ self.matrix[slot, k].T + self.offset[slot, k]
            other = mean + noise @ self.doubt[slot, k].T
            heard = torch.where((kind == k)[:, None], other, heard)
        kept = torch.rand(len(told), 1, device=told.device) >= self.share
        return torch.where(kept, told, heard).view_as(touch)


def other_sensors(config: PI05UniforceConfig) -> OtherSensors:
    """Return the module for a policy that is about to be trained; ``config.trained_sensors`` is filled.

    Raises:
        CheckpointError: the tokenizer comes without maps, or they are another tokenizer's.
        ContractError: a slot's demos are of several kinds, of none that is stated, or of one without maps.
    """
    transfer = SensorTransfer.from_pretrained(config.tokenizer_path)
    if transfer.tokenizer_hash != config.tokenizer_hash:
        do = "Run uniforce-sensor-transfer for this tokenizer."
        raise CheckpointError(
            expected("tokenizer of the maps", config.tokenizer_hash, transfer.tokenizer_hash, do)
        )
    numbers = config.tokens_per_slot * config.latent_size
    if transfer.offset.shape[-1] != numbers:
        do = "Run uniforce-sensor-transfer with fit.grid as policy.latent_grid."
        raise ContractError(expected("numbers per slot", numbers, transfer.offset.shape[-1], do))
    worn = [config.trained_sensors.get(slot, "") for slot in config.slots]
    return OtherSensors(transfer, worn, config.sensor_transfer)
