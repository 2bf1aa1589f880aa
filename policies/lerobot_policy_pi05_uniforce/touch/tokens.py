"""Touch as tokens: K force tokens per slot, and the gate on their weight in attention."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import FORCES, PI05UniforceConfig

SHUT = 1e-6  # gate at the start, and the least that is left of it: a logit of −13.5


@dataclass(frozen=True)
class Felt:
    """The measured state, and the input of each touch slot in the order of the policy's slots."""

    state: Tensor | None = None  # (B, 1, S); None: the policy takes no state token
    touches: Any = None  # (slots, B, K or 1, numbers); None: it takes no touch
    masks: Any = None  # (slots, B) bool, False where a slot is lost or hidden

    def real(self, tokens_per_slot: int) -> Tensor:
        """Return (B, slots · K) bool: which force tokens are of a slot that is there."""
        return self.masks.T.repeat_interleave(tokens_per_slot, dim=1)


NOTHING = Felt()


class ForceTokens(nn.Module):
    """Project each slot's touch input to K tokens; an embedding tells the slots apart.

    The input keeps its amplitude, because amplitude is force. A fixed mean per number and a fixed
    spread per channel are taken out, never the input's own. Only the outcome is RMS-normalised, so
    that force tokens enter with the magnitude of an image patch; a learned gain follows.
    Where ``config.whole_map``, every token also holds a projection of the slot's whole map: force
    is a sum over patches, which attention over single patches reads less exactly.
    """

    def __init__(
        self, config: PI05UniforceConfig, input_shape: tuple[int, int], width: int
    ) -> None:
        super().__init__()
        numbers = input_shape[1]
        scale = torch.ones(numbers)
        if config.touch.input != "latent":
            scale = torch.tensor(FORCES[config.touch.input], dtype=torch.float32)
        self.register_buffer("input_mean", torch.zeros(input_shape))
        self.register_buffer("input_scale", scale)
        self.proj = _two_layers(numbers, width)
        self.whole = None
        if config.whole_map:
            self.whole = _two_layers(math.prod(input_shape), width)
        self.cell_embedding = nn.Parameter(0.5 * torch.randn(config.tokens_per_slot, width))
        self.slot_embedding = nn.Parameter(0.5 * torch.randn(len(config.slots), width))
        self.gain = nn.Parameter(torch.ones(1))  # not a scalar: FSDP shards none

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Map (B, K or 1, numbers) to (B, K, D); one row (a force) is spread over all K tokens."""
        features = (touch - self.input_mean) / self.input_scale
        hidden = self.proj(features)  # (B, K or 1, D)
        if self.whole is not None:
            hidden = hidden + self.whole(features.flatten(1))[:, None]
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]  # (B, K, D)
        return self.gain * F.rms_norm(hidden, hidden.shape[-1:])


def _two_layers(size: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(size, width), nn.GELU(), nn.Linear(width, width))


class TouchGate(nn.Module):
    """Scale the weight of each slot's tokens in all attention; nearly shut at the start.

    Appended tokens change the base's actions, even zeros: they take their share of every softmax,
    and they move the actions' positions. Behind the gate a slot's tokens have their weight times
    its gate g (an additive logit, log g), and all stand at the position of the last token before
    them. At g = 1e-6 the actions are the base's within 1e-5. At g = 1 they count as any other.

    The parameter is g, not log g: the gradient by log g is proportional to g and would stand still.
    Its sign doesn't count, so that nothing ends at zero.
    """

    def __init__(self, num_slots: int) -> None:
        super().__init__()
        self.gate = nn.Parameter(torch.full((num_slots,), SHUT))

    def forward(self, num_slots: int, tokens_per_slot: int) -> Tensor:
        """Return the additive logit of each force token, (num_slots · tokens_per_slot,) float32."""
        logit = 0.5 * (self.gate.float().square() + SHUT**2).log()
        return logit[:num_slots].repeat_interleave(tokens_per_slot)


@dataclass(frozen=True)
class GatedColumns:
    """Where force tokens stand among the columns of attention, and with which weight."""

    first: int  # column of the first force token
    bias: Tensor  # (N,) additive logit per force token
    real: Tensor  # (B, N) bool, False where a slot is lost or hidden

    def masked(self, mask: Tensor) -> Tensor:
        """Return an additive mask (B, 1, rows, L) with the gate's logits, where touch is in L."""
        room = mask.shape[-1] - self.first - len(self.bias)
        if room < 0:
            return mask
        return mask + F.pad(self.bias, (self.first, room)).to(mask.dtype)

    def placed(self, positions: Tensor, length: int) -> Tensor:
        """Return positions (B, n) of the last n of ``length`` tokens as they were without touch."""
        room = length - self.first - self.real.shape[1]
        if room < 0:
            return positions
        before = F.pad(self.real, (self.first, room)).cumsum(dim=1)  # (B, length)
        return positions - before[:, -positions.shape[1] :]
