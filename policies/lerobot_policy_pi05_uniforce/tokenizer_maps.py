"""What was fitted to a tokenizer before any policy existed (``uniforce-sensor-transfer``), as a new policy takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
    from lerobot_policy_pi05_uniforce.force_tokens import ForceTokens


def tokenizer_maps(config: PI05UniforceConfig) -> SensorTransfer:
    """Return maps between sensors and the directions they agree on.

    Raises:
        CheckpointError: the tokenizer comes without, or they are another tokenizer's.
        ContractError: they are of another grid.
    """
    transfer = SensorTransfer.from_pretrained(config.tokenizer_path, config.tokenizer_hash)
    numbers = config.tokens_per_slot * config.latent_size
    if transfer.rest.shape[-1] != numbers:
        do = "Run uniforce-sensor-transfer with fit.grid as policy.latent_grid."
        raise ContractError(expected("numbers per slot", numbers, transfer.rest.shape[-1], do))
    return transfer


def take_directions(tokens: ForceTokens, config: PI05UniforceConfig) -> None:
    """Give a new policy's tokens the directions on which all sensors agree; the checkpoint keeps them.

    Raises:
        CheckpointError, ContractError: as ``tokenizer_maps``.
    """
    transfer, count = tokenizer_maps(config), config.touch_directions
    tokens.directions.copy_(transfer.directions[:, :count])
    tokens.origin.copy_(transfer.origin[:count])
    tokens.disagreement.copy_(transfer.disagreement[:count])
