"""Control in place of touch: the true wrench of the pad, which only a simulator knows."""

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.touch.tokens import ForceTokens
from lerobot_policy_pi05_uniforce.touch.touch_input import TouchInput, taken
from uniforce_vtla.keys import wrench_key

# N, N, N, Nmm: a firm wipe's shear, press and torsion become ~1
WRENCH_SCALE = (5.0, 5.0, 10.0, 100.0)
SHAPES = {
    "newtons": (1, 3),  # fx, fy, fz in N
    "wrench": (1, len(WRENCH_SCALE)),  # and torsion in Nmm
}


class TrueWrench(TouchInput):
    """Reads the true wrench from the batch: the ceiling of any sense of touch."""

    def __init__(self, config: PI05UniforceConfig) -> None:
        super().__init__(config, SHAPES["wrench"])

    def read(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor:
        """Return (B, 1, 4) of a slot; RolloutError where it isn't in the batch."""
        return taken(batch, wrench_key(slot)).to(device, torch.float32)[:, None]


def newton_tokens(config: PI05UniforceConfig, width: int) -> ForceTokens:
    """Return the tokens of a policy that feels newtons or the true wrench."""
    tokens = ForceTokens(config, SHAPES[config.touch.input], width)
    tokens.input_scale.copy_(torch.tensor(WRENCH_SCALE[: tokens.input_scale.numel()]))
    return tokens
