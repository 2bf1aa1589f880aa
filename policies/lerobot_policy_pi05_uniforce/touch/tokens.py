"""Pooled latents of one touch slot → K force tokens, and the gate behind which they may enter attention."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

SHUT = 1e-6  # gate at the start, and the least that is left of it: a logit of −13.5


@dataclass(frozen=True)
class SuffixTouch:
    """Force tokens in front of the noisy actions: ``tokens`` (B, N, D_expert), ``mask`` (B, N) bool."""

    tokens: Tensor
    mask: Tensor


class ForceTokens(nn.Module):
    """Project each slot's touch input to K tokens; one projection for all slots, an embedding tells them apart.

    The input keeps its amplitude (amplitude is force): a fixed mean per number is taken off and a fixed spread per
    channel divided out, both stored in the checkpoint, never its own. Only the outcome is RMS-normalised, after a
    non-linearity, so that force tokens enter with the magnitude of an image patch; a learned gain takes it from there.
    Where ``config.whole_map``, every token also holds what one network makes of the slot's whole map: force is a sum
    over cells, which attention over single cells reads less exactly.
    """

    def __init__(
        self, config: PI05UniforceConfig, input_shape: tuple[int, int], width: int
    ) -> None:
        super().__init__()
        self.register_buffer("input_mean", torch.zeros(input_shape))
        self.register_buffer("input_scale", torch.ones(input_shape[1]))
        self.proj = _two_layers(input_shape[1], width)
        self.whole = _two_layers(math.prod(input_shape), width) if config.whole_map else None
        self.cell_embedding = nn.Parameter(0.5 * torch.randn(config.tokens_per_slot, width))
        self.slot_embedding = nn.Parameter(0.5 * torch.randn(len(config.slots), width))
        self.gain = nn.Parameter(torch.ones(1))  # not a scalar: FSDP shards none

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Map (B, K or 1, input_size) to (B, K, D); one row (a wrench) is spread over all K cells."""
        features = (touch - self.input_mean) / self.input_scale
        hidden = self.proj(features)  # (B, K or 1, D)
        if self.whole is not None:
            hidden = hidden + self.whole(features.flatten(1))[:, None]
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]  # (B, K, D)
        return self.gain * F.rms_norm(hidden, hidden.shape[-1:])


def _two_layers(size: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(size, width), nn.GELU(), nn.Linear(width, width))


class TouchGate(nn.Module):
    """Start at the base: a learnt gate per slot on the weight of its tokens in all attention, nearly shut.

    Appending tokens is not the identity, not even zeros: they take their share of every softmax, and they move the
    actions' positions. So, where ``start_at_base`` is on, a slot's tokens enter every softmax with their weight times
    the slot's gate g (an additive logit, log g), and all stand at the position of the last token before them. With g =
    1e-6 the policy gives the base's actions within 1e-5 (tests); with g = 1 the tokens count as any other. Why g is
    learnt and not its logarithm: the gradient by log g is itself proportional to g, and would stand still. Its sign
    doesn't count, so that nothing ends at zero.
    """

    def __init__(self, num_slots: int) -> None:
        super().__init__()
        self.gate = nn.Parameter(torch.full((num_slots,), SHUT))

    def forward(self, num_slots: int, tokens_per_slot: int) -> Tensor:
        """Return the additive logit of each touch token, (num_slots · tokens_per_slot,) float32."""
        logit = 0.5 * (self.gate.float().square() + SHUT**2).log()
        return logit[:num_slots].repeat_interleave(tokens_per_slot)


@dataclass(frozen=True)
class GatedColumns:
    """Where touch stands among the columns of attention, and with which weight."""

    first: int  # column of the first touch token
    bias: Tensor  # (N,) additive logit per touch token
    real: Tensor  # (B, N) bool, False where a slot is lost or hidden

    def masked(self, mask: Tensor) -> Tensor:
        """Return an additive mask (B, 1, rows, L) with touch's logits in it; as it is where L ends before touch."""
        room = mask.shape[-1] - self.first - len(self.bias)
        return mask if room < 0 else mask + F.pad(self.bias, (self.first, room)).to(mask.dtype)

    def placed(self, positions: Tensor, length: int) -> Tensor:
        """Return the positions (B, n) of the last n of ``length`` tokens as they would be without touch."""
        room = length - self.first - self.real.shape[1]
        if room < 0:
            return positions
        before = F.pad(self.real, (self.first, room)).cumsum(dim=1)  # (B, length)
        return positions - before[:, -positions.shape[1] :]
