"""Training only: part of what is felt, told as another finger with another sensor would have told it.

The maps are the tokenizer's (uniforce_vtla/tokenizer/sensor_transfer.py), made from simulated grasps before any
policy exists. Nothing of this is stored in a checkpoint or runs when actions are sampled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.tokenizer_maps import tokenizer_maps
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig


class TransferredTouch(nn.Module):
    """Replace a share of each slot's latents by what another finger with a random known sensor would have said.

    Args:
        transfer: maps between sensors.
        worn: the sensor of each slot in the training data.
        share: chance per sample; each known sensor is as likely, the slot's own kind (another unit) too.
        doubt: how much of the maps' doubt is drawn, 0 to 1.
    """

    def __init__(self, transfer: SensorTransfer, worn: Sequence[str], share: float, doubt: float) -> None:
        super().__init__()
        self.share, self.doubt, self._rows = share, doubt, [transfer.row(kind) for kind in worn]
        self._transfer = (transfer,)  # in a tuple: no part of the policy, which saves its modules

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Return (B, K, latent) latents of a slot, some of them told by other fingers."""
        transfer, told = self._transfer[0].to(touch.device), touch.flatten(1)  # (B, n)
        kind = torch.randint(len(transfer.kinds), (len(told), 1), device=told.device)
        kind = torch.where(torch.rand_like(told[:, :1]) < self.share, kind, -1)  # -1: as it is
        heard = told
        for target in range(len(transfer.kinds)):
            other = transfer.told(told, self._rows[slot], target, self.doubt)
            heard = torch.where(kind == target, other, heard)
        return heard.view_as(touch)


def transferred_touch(config: PI05UniforceConfig) -> TransferredTouch:
    """Return the module for a policy that is about to be trained; ``config.trained_sensors`` is filled.

    Raises:
        CheckpointError: the tokenizer comes without maps, or they are another tokenizer's.
        ContractError: a slot's demos are of several kinds, of none that is stated, or of one without maps.
    """
    transfer = tokenizer_maps(config)
    worn = [config.trained_sensors.get(slot, "") for slot in config.slots]
    return TransferredTouch(transfer, worn, config.sensor_transfer, config.sensor_transfer_doubt)
