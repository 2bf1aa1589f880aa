"""The network: LeRobot's π0.5 whose prefix also holds a state token and force tokens."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.backbone import make_backbone
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.touch.encoder import build_frozen_touch
from lerobot_policy_pi05_uniforce.touch.tokens import (
    NOTHING,
    Felt,
    ForceTokens,
    GatedColumns,
    TouchGate,
)
from lerobot_policy_pi05_uniforce.training import freeze_unread
from lerobot_policy_pi05_uniforce.weights import no_weights


class Inputs(NamedTuple):
    """An observation: cameras, text, state and touch."""

    images: list[Tensor]  # (B, 3, H, W) each
    img_masks: list[Tensor]  # (B,) bool each
    tokens: Tensor  # (B, L) text
    masks: Tensor  # (B, L) bool
    felt: Felt = NOTHING


class StateToken(nn.Module):
    """The normalised state as one prefix token: text bins are too coarse to learn a few demos."""

    def __init__(self, state_size: int, width: int) -> None:
        super().__init__()
        self.proj = nn.Sequential(nn.Linear(state_size, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, state: Tensor) -> Tensor:
        """Map (B, 1, state size) to (B, 1, D) of unit RMS."""
        hidden = self.proj(state)
        return F.rms_norm(hidden, hidden.shape[-1:])


class PI05UniforcePytorch(stock.PI05Pytorch):
    """π0.5's network with a state token and force tokens behind cameras and text."""

    def __init__(
        self, config: PI05UniforceConfig, rtc_processor: Any = None, empty: bool = False
    ) -> None:
        # the parent names its own backbone, and would build both language heads
        nn.Module.__init__(self)
        self.config = config
        self.rtc_processor = rtc_processor
        self.gradient_checkpointing_enabled = False
        with no_weights() if empty else nullcontext():
            self._build_stock(config)
        # of the call in progress: LeRobot's loops hand no more than cameras and text on
        self._felt = NOTHING
        self.tactile_encoder: Any = None
        self.force_tokens: Any = None
        self.touch_gate: Any = None
        self.state_token: Any = None
        vlm_width = self.vlm.config.hidden_size
        if config.encodes:
            self.tactile_encoder = build_frozen_touch(config, empty)
        if config.slots:
            self.force_tokens = ForceTokens(config, config.touch_shape, vlm_width)
        if config.slots and config.touch.start_at_base:
            self.touch_gate = TouchGate(len(config.slots))
        if config.state_token:
            self.state_token = StateToken(config.state_size, vlm_width)
        freeze_unread(self.vlm)
        self.adapted = False  # PEFT's adapters are in: sampled by LeRobot's loop, which runs them
        self.fast: Any = None  # the fast sampler, given by the policy; None: LeRobot's loop
        if config.compile_model:  # as LeRobot's own constructor
            torch.set_float32_matmul_precision("high")
            for name in ("sample_actions", "forward"):
                setattr(self, name, torch.compile(getattr(self, name), mode=config.compile_mode))

    def _build_stock(self, config: PI05UniforceConfig) -> None:
        """Build π0.5's modules but the language heads: 0.79 B weights that nothing reads."""
        self.paligemma_with_expert = make_backbone(config)
        width = self.expert.config.hidden_size
        self.action_in_proj = nn.Linear(config.max_action_dim, width)
        self.action_out_proj = nn.Linear(width, config.max_action_dim)
        self.time_mlp_in = nn.Linear(width, width)
        self.time_mlp_out = nn.Linear(width, width)
        self.paligemma_with_expert.paligemma.lm_head = nn.Identity()
        self.paligemma_with_expert.gemma_expert.lm_head = nn.Identity()

    @property
    def vlm(self) -> Any:
        """The VLM's language model."""
        return self.paligemma_with_expert.paligemma.model.language_model

    @property
    def expert(self) -> Any:
        """The action expert."""
        return self.paligemma_with_expert.gemma_expert.model

    def sample_actions(
        self,
        images: list[Tensor],
        img_masks: list[Tensor],
        tokens: Tensor,
        masks: Tensor,
        felt: Felt,
        noise: Tensor,
        num_steps: int | None = None,
        **kwargs: Any,
    ) -> Tensor:
        """Return (B, chunk, max_action_dim) by LeRobot's loop, or by the fast one.

        RTC (``config.rtc_config``) differentiates through the flow: LeRobot's loop samples.
        """
        if self.fast is None or self.adapted or self.rtc_processor is not None:
            with self.feeling(felt):
                return super().sample_actions(
                    images, img_masks, tokens, masks, noise=noise, num_steps=num_steps, **kwargs
                )
        inputs = Inputs(images, img_masks, tokens, masks, felt)
        return self.fast.sample(inputs, noise, num_steps or self.config.num_inference_steps)

    def forward(
        self,
        images: list[Tensor],
        img_masks: list[Tensor],
        tokens: Tensor,
        masks: Tensor,
        felt: Felt,
        **flow: Tensor,
    ) -> Tensor:
        """Return LeRobot's flow-matching losses, (B, chunk, max_action_dim).

        Text is cut to the batch's longest prompt: half of what ``tiny`` computes would be padding.

        Args:
            images: cameras (B, 3, H, W).
            img_masks: (B,) bool each.
            tokens: (B, L) text.
            masks: (B, L) bool.
            felt: state and touch.
            flow: ``actions`` and ``noise`` (B, chunk, max_action_dim), and ``time`` (B,).
        """
        if not self.config.compile_model:  # compiled code wants one length
            tokens, masks = drop_padding(tokens, masks)
        with self.feeling(felt):
            return super().forward(images, img_masks, tokens, masks, **flow)

    @contextmanager
    def feeling(self, felt: Felt) -> Iterator[None]:
        """Hand state and touch to ``embed_prefix`` around LeRobot's loops."""
        self._felt = felt
        try:
            yield
        finally:
            self._felt = NOTHING

    def embed_prefix(
        self,
        images: list[Tensor],
        img_masks: list[Tensor],
        tokens: Tensor,
        masks: Tensor,
        *_: None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Embed cameras and text as π0.5 does, then append state and force tokens to their block.

        Appended last, they leave image and text positions as they were. LeRobot's main also hands
        over past states and their masks: None, since our settings refuse its memory.
        """
        embs, pads, atts = super().embed_prefix(images, img_masks, tokens, masks)
        before = embs.shape[1]
        embs, pads, self.paligemma_with_expert.gated = self.append_felt(self._felt, embs, pads)
        # False: sees the whole prefix
        return embs, pads, F.pad(atts, (0, embs.shape[1] - before))

    def append_felt(
        self, felt: Felt, embs: Tensor, real: Tensor
    ) -> tuple[Tensor, Tensor, GatedColumns | None]:
        """Append the state's token and force tokens to cameras and text.

        Args:
            felt: state and touch.
            embs: (B, L, D) tokens of cameras and text.
            real: (B, L) bool, False where one is padding.

        Returns both with what was appended, and touch's columns in attention where it is gated.
        """
        parts = [embs]
        reals = [real]
        if felt.state is not None:
            parts.append(self.state_token(felt.state).to(embs.dtype))  # (B, 1, D)
            reals.append(torch.ones_like(real[:, :1]))
        gated = None
        if felt.touches is not None:
            count = self.config.tokens_per_slot
            real_touch = felt.real(count)
            if self.touch_gate is not None:
                bias = self.touch_gate(len(felt.touches), count)
                gated = GatedColumns(embs.shape[1] + len(parts) - 1, bias, real_touch)
            for slot, touch in enumerate(felt.touches):
                parts.append(self.force_tokens(touch, slot).to(embs.dtype))
            reals.append(real_touch)
        return torch.cat(parts, dim=1), torch.cat(reals, dim=1), gated


def drop_padding(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Return text (B, L) and its mask without the columns that no prompt of the batch uses."""
    used = masks.any(dim=0).cpu().tolist()
    while used and not used[-1]:
        used.pop()
    return tokens[:, : len(used)], masks[:, : len(used)]
