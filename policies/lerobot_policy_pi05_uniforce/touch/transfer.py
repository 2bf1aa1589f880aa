"""What was fitted to a tokenizer before any policy existed (``benchmarks.sensor_transfer``), as a new policy takes it.

Maps between sensors, for training alone: nothing of them is stored in a checkpoint or runs when actions are sampled.
The directions on which all sensors agree: a checkpoint keeps them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
    from lerobot_policy_pi05_uniforce.touch.tokens import ForceTokens

# of the maps' noise that is drawn: all of it makes a policy answer swapped fingers less, and reads them no better
SPREAD = 0.25


class TransferredTouch(nn.Module):
    """Replace a ``share`` of each slot's latents by another finger's, with a random known sensor.

    Each known sensor is as likely, the slot's own kind (another unit) too; ``worn`` is the sensor of each slot in the
    training data.
    """

    def __init__(self, transfer: SensorTransfer, worn: Sequence[str], share: float, spread: float = SPREAD) -> None:
        super().__init__()
        self.share, self.spread, self._rows = share, spread, [transfer.row(kind) for kind in worn]
        self._transfer = (transfer,)  # in a tuple: no part of the policy, which saves its modules

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Return (B, K, latent) latents of a slot, some of them mapped to other sensors."""
        transfer, own = self._transfer[0].to(touch.device), touch.flatten(1)  # (B, n)
        kind = torch.randint(len(transfer.kinds), (len(own), 1), device=own.device)
        kind = torch.where(torch.rand_like(own[:, :1]) < self.share, kind, -1)  # -1: as it is
        mapped = own
        for target in range(len(transfer.kinds)):
            other = transfer.mapped(own, self._rows[slot], target, self.spread)
            mapped = torch.where(kind == target, other, mapped)
        return mapped.view_as(touch)


def tokenizer_maps(config: PI05UniforceConfig) -> SensorTransfer:
    """Return maps between sensors and the directions they agree on.

    Raises:
        CheckpointError: the tokenizer comes without, or they are another tokenizer's or grid's.
    """
    transfer = SensorTransfer.from_pretrained(config.touch.tokenizer_path, config.tokenizer_hash)
    wanted, came = config.tokens_per_slot * config.latent_size, transfer.rest.shape[-1]
    if came != wanted:
        do = f"Run python -m benchmarks.sensor_transfer with fit.grid={config.latent_grid}."
        raise CheckpointError(expected("numbers of the maps", wanted, came, do))
    return transfer


def transferred_touch(config: PI05UniforceConfig) -> TransferredTouch:
    """Return the module for a policy that is about to be trained; ``touch.trained_sensors`` is filled.

    Raises:
        CheckpointError: as ``tokenizer_maps``.
        ContractError: a slot's demos are of several kinds, of none that is stated, or of one without maps.
    """
    worn = [config.touch.trained_sensors.get(slot, "") for slot in config.slots]
    return TransferredTouch(tokenizer_maps(config), worn, config.augment.sensor_transfer)


def take_directions(tokens: ForceTokens, config: PI05UniforceConfig) -> None:
    """Give a new policy's tokens the directions on which all sensors agree; raises as ``tokenizer_maps``."""
    transfer, count = tokenizer_maps(config), config.touch.directions
    tokens.directions.copy_(transfer.directions[:, :count])
    tokens.origin.copy_(transfer.origin[:count])
    tokens.disagreement.copy_(transfer.disagreement[:count])
