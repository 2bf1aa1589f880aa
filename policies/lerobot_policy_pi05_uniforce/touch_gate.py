"""Start at the base: a learnt gate on how loud touch is in everybody's attention, nearly shut at first.

Appending tokens is not the identity, not even zeros: they take their share of every softmax, and they move the actions'
positions. So, where ``start_at_base`` is on, a slot's tokens enter every softmax with their weight times the slot's
gate g (an additive logit, log g), and all stand at the position of the last token before them, so that nothing behind
them moves. With g = 1e-6 the policy gives the base's actions within 1e-5 (tests), whatever was felt; with g = 1 the
tokens count as any other. Why a factor learnt directly and not its logarithm: the gradient by log g is itself
proportional to g, and would stand still; the gradient by g is of full size from the first step.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

SHUT = 1e-6  # gate at the start, and the least that is left of it: a logit of −13.5


class TouchGate(nn.Module):
    """One gate per slot; its sign says nothing, so that nothing ends at zero."""

    def __init__(self, num_slots: int) -> None:
        super().__init__()
        self.gate = nn.Parameter(torch.full((num_slots,), SHUT))

    def forward(self, num_slots: int, tokens_per_slot: int) -> Tensor:
        """Return the additive logit of each touch token, (num_slots · tokens_per_slot,) float32."""
        logit = 0.5 * (self.gate.float().square() + SHUT**2).log()
        return logit[:num_slots].repeat_interleave(tokens_per_slot)


@dataclass(frozen=True)
class Heard:
    """Where touch stands among the columns of attention, and how loud it is.

    Attributes:
        first: column of the first touch token.
        bias: (N,) additive logit per touch token.
        real: (B, N) bool, False where a slot is lost or hidden.
    """

    first: int
    bias: Tensor
    real: Tensor

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


class GatedBackbone(stock.PaliGemmaWithExpertModel):
    """LeRobot's VLM and action expert, whose attention hears touch as loud as its gate says.

    ``heard`` is set by every ``embed_prefix`` and stays until the next: gradient checkpointing runs this again later.
    """

    heard: Heard | None = None
    keep_suffix = (
        False  # True: the expert's outputs of the latest call stay in ``suffix``, for an auxiliary loss
    )
    suffix: Tensor | None = None

    def forward(
        self,
        attention_mask: Tensor | None = None,
        position_ids: Tensor | None = None,
        past_key_values: object = None,
        inputs_embeds: list | None = None,
        use_cache: bool | None = None,
        adarms_cond: list | None = None,
    ) -> tuple[list, object]:
        """Run prefix, suffix or both; arguments as LeRobot's."""
        if self.heard is not None and attention_mask is not None and position_ids is not None:
            position_ids = self.heard.placed(position_ids, attention_mask.shape[-1])
            attention_mask = self.heard.masked(attention_mask)
        streams, cond = inputs_embeds or [None, None], adarms_cond or [None, None]
        out, past = self.run_layers(attention_mask, position_ids, past_key_values, streams, use_cache, cond)
        self.suffix = out[1] if self.keep_suffix and self.training else None
        return out, past

    def run_layers(
        self,
        mask: Tensor | None,
        positions: Tensor | None,
        past: object,
        streams: list,
        use_cache: bool | None,
        cond: list,
    ) -> tuple[list, object]:
        """Run LeRobot's own layers."""
        return super().forward(mask, positions, past, streams, use_cache=use_cache, adarms_cond=cond)
