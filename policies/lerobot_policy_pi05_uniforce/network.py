"""The network: LeRobot's π0.5 whose prefix also holds a state token and force tokens."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.backbone import make_backbone
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import ENCODED, PI05UniforceConfig
from lerobot_policy_pi05_uniforce.sampler.fast import FastSampler
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs, drop_padding
from lerobot_policy_pi05_uniforce.touch.controls import newton_tokens
from lerobot_policy_pi05_uniforce.touch.encoder import build_frozen_touch
from lerobot_policy_pi05_uniforce.touch.felt import NOTHING, Felt
from lerobot_policy_pi05_uniforce.touch.tokens import (
    ForceTokens,
    GatedColumns,
    SuffixTouch,
    TouchGate,
)
from lerobot_policy_pi05_uniforce.training import freeze_unread
from lerobot_policy_pi05_uniforce.weights import no_weights
from uniforce_vtla.keys import STATE

PREVIOUS_NOISE = 0.1  # on the previous action, training only, in units of ``delta_scale``


class StateToken(nn.Module):
    """The continuous normalised state as one prefix token: text bins are too coarse to learn from few demos.

    Behind the state stand the chosen axes of the previous action, with a little noise while training.
    """

    def __init__(self, config: PI05UniforceConfig, width: int) -> None:
        super().__init__()
        size, moves = state_size(config), len(config.previous_axes)
        self.noise = (*[0.0] * size, *[PREVIOUS_NOISE] * moves)
        self.proj = nn.Sequential(
            nn.Linear(size + moves, width), nn.GELU(), nn.Linear(width, width)
        )

    def forward(self, state: Tensor) -> Tensor:
        """Map (B, 1, state size + moves) to (B, 1, D) of unit RMS."""
        if self.training and any(self.noise):
            state = state + torch.randn_like(state) * state.new_tensor(self.noise)
        hidden = self.proj(state)
        return nn.functional.rms_norm(hidden, hidden.shape[-1:])


class PI05UniforcePytorch(stock.PI05Pytorch):
    """π0.5's network with a state token and force tokens behind cameras and text.

    At ``touch.site=prefix`` force tokens join cameras and text and are encoded once per observation. At ``suffix`` they
    stand before the noisy actions in the action expert, which reads them again in every flow step; they see the prefix
    and each other, never the actions.
    """

    def __init__(
        self, config: PI05UniforceConfig, rtc_processor: Any = None, empty: bool = False
    ) -> None:
        # the parent names its own backbone, and would build both language heads
        nn.Module.__init__(self)
        self.config, self.rtc_processor = config, rtc_processor
        self.gradient_checkpointing_enabled = False
        with no_weights() if empty else nullcontext():
            self._build_stock(config)
        # of the call in progress: LeRobot's own loops hand no more than cameras and text on
        self._felt = NOTHING
        self._touch: SuffixTouch | None = None  # at touch.site=suffix
        encodes = bool(config.slots) and config.touch.input in ENCODED
        self.tactile_encoder = build_frozen_touch(config, empty) if encodes else None
        vlm_width = self.paligemma_with_expert.paligemma.config.text_config.hidden_size
        width = vlm_width if config.touch.site == "prefix" else self.action_in_proj.out_features
        self.force_tokens: Any = self._make_force_tokens(config, width)
        gated = config.touch.start_at_base and bool(config.slots)
        self.touch_gate = TouchGate(len(config.slots)) if gated else None
        self.state_token: Any = StateToken(config, vlm_width) if config.state_token else None
        freeze_unread(self)
        self.adapted = False  # PEFT's adapters are in: sampled by LeRobot's loop, which runs them
        self.fast = None if config.sampler.kind == "stock" else FastSampler(self)
        if config.compile_model:  # as LeRobot's own constructor
            torch.set_float32_matmul_precision("high")
            for name in ("sample_actions", "forward"):
                setattr(self, name, torch.compile(getattr(self, name), mode=config.compile_mode))

    def _build_stock(self, config: PI05UniforceConfig) -> None:
        """Build π0.5's modules, without the language heads: 0.79 B weights that nothing reads or trains."""
        self.paligemma_with_expert = make_backbone(config)
        width = self.paligemma_with_expert.gemma_expert.config.hidden_size
        self.action_in_proj = nn.Linear(config.max_action_dim, width)
        self.action_out_proj = nn.Linear(width, config.max_action_dim)
        self.time_mlp_in = nn.Linear(width, width)
        self.time_mlp_out = nn.Linear(width, width)
        self.paligemma_with_expert.paligemma.lm_head = nn.Identity()
        self.paligemma_with_expert.gemma_expert.lm_head = nn.Identity()

    def _make_force_tokens(self, config: PI05UniforceConfig, width: int) -> nn.Module | None:
        if not config.slots:
            return None
        if config.touch.input != "latent":
            return newton_tokens(config, width)
        return ForceTokens(config, (config.tokens_per_slot, config.latent_size), width)

    def sample_actions(
        self,
        images: list,
        img_masks: list,
        tokens: Tensor,
        masks: Tensor,
        felt: Felt = NOTHING,
        noise: Tensor | None = None,
        num_steps: int | None = None,
        **kwargs: Any,
    ) -> Tensor:
        """Return (B, chunk, max_action_dim) by LeRobot's own loop, or the fast one with the same result.

        RTC (``config.rtc_config``) differentiates through the flow: LeRobot's loop samples.
        """
        inputs = Inputs(images, img_masks, tokens, masks, felt)
        if self.fast is None or self.adapted or self.rtc_processor is not None:
            seen = {"images": images, "img_masks": img_masks, "tokens": tokens, "masks": masks}
            with self.feeling(felt):
                return super().sample_actions(**seen, noise=noise, num_steps=num_steps, **kwargs)
        if noise is None:
            shape = (len(tokens), self.config.chunk_size, self.config.max_action_dim)
            noise = self.sample_noise(shape, tokens.device)
        return self.fast.sample(inputs, noise, num_steps or self.config.num_inference_steps)

    def forward(
        self,
        images: list,
        img_masks: list,
        tokens: Tensor,
        masks: Tensor,
        felt: Felt = NOTHING,
        **flow: Tensor,
    ) -> Tensor:
        """Return LeRobot's flow-matching losses, (B, chunk, max_action_dim).

        Text is cut to the batch's longest prompt: padding changes nothing, and is half of what ``tiny`` computes.

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
            return super().forward(
                images=images, img_masks=img_masks, tokens=tokens, masks=masks, **flow
            )

    @contextmanager
    def feeling(self, felt: Felt) -> Iterator[None]:
        """Let ``embed_prefix`` and ``embed_suffix`` know state and touch while one of LeRobot's loops runs."""
        self._felt = felt
        try:
            yield
        finally:
            self._felt = NOTHING
            self._touch = None

    def embed_prefix(
        self,
        images: list,
        img_masks: list,
        tokens: Tensor,
        masks: Tensor,
        felt: Felt | None = None,
        **kwargs: Any,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Embed cameras and text as π0.5 does, then append state and (at that site) force tokens to the same block.

        Appended last, they leave image and text positions as they were; a masked token changes nothing.
        """
        felt = self._felt if felt is None else felt
        seen = {"images": images, "img_masks": img_masks, "tokens": tokens, "masks": masks}
        embs, pads, atts = super().embed_prefix(**seen, **kwargs)
        self._touch = self.suffix_touch(felt)
        behind, self.paligemma_with_expert.gated = self.embed_felt(felt, before=embs.shape[1])
        for embedded, mask in behind:
            count = embedded.shape[1]
            embs = torch.cat([embs, embedded.to(embs.dtype)], dim=1)  # (B, L + count, D)
            pads = torch.cat([pads, mask[:, None].expand(-1, count)], dim=1)
            # 0: sees the whole prefix
            atts = torch.cat([atts, atts.new_zeros(embedded.shape[:2])], dim=1)
        return embs, pads, atts

    def embed_suffix(
        self, noisy_actions: Tensor, timestep: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Embed noisy actions as π0.5 does, force tokens before them at ``touch.site=suffix``."""
        embs, pads, atts, cond = super().embed_suffix(noisy_actions, timestep)
        if self._touch is None:
            return embs, pads, atts, cond
        block = atts.new_zeros(self._touch.mask.shape)
        block[:, 0] = 1  # a block of its own between prefix and actions
        # (B, N + chunk, D_expert)
        embs = torch.cat([self._touch.tokens.to(embs.dtype), embs], dim=1)
        pads, atts = torch.cat([self._touch.mask, pads], dim=1), torch.cat([block, atts], dim=1)
        return embs, pads, atts, cond

    def embed_felt(
        self, felt: Felt, before: int
    ) -> tuple[list[tuple[Tensor, Tensor]], GatedColumns | None]:
        """Return the tokens behind ``before`` ones of cameras and text, and the weight of touch, if not 1.

        The first is (B, ·, D) tokens and (B,) mask of the state, and at that site of every touch slot, in that order.
        """
        behind: list[tuple[Tensor, Tensor]] = []
        if felt.state is not None:
            real = torch.ones_like(felt.state[:, 0, 0], dtype=torch.bool)  # (B,)
            behind.append((self.state_token(felt.state), real))
        states = len(behind)
        if self.config.touch.site == "prefix":
            behind += self._touches(felt)
        gated = None
        if self.touch_gate is not None and felt.touches:
            count = self.config.tokens_per_slot
            pads = torch.cat([mask[:, None].expand(-1, count) for mask in felt.masks], dim=1)
            gated = GatedColumns(before + states, self.touch_gate(len(felt.touches), count), pads)
        return behind, gated

    def suffix_touch(self, felt: Felt) -> SuffixTouch | None:
        """Return all slots' tokens for the suffix; None at the other site or without touch."""
        if self.config.touch.site != "suffix" or not felt.touches:
            return None
        embedded = self._touches(felt)
        tokens = torch.cat([of_slot for of_slot, _ in embedded], dim=1)  # (B, slots · K, D_expert)
        pads = [mask[:, None].expand(-1, of_slot.shape[1]) for of_slot, mask in embedded]
        return SuffixTouch(tokens, torch.cat(pads, dim=1))

    def _touches(self, felt: Felt) -> list[tuple[Tensor, Tensor]]:
        """Return (B, K, D) tokens and (B,) mask of each slot."""
        return [
            (self.force_tokens(touch, slot), mask)
            for slot, (touch, mask) in enumerate(zip(felt.touches, felt.masks, strict=True))
        ]


def state_size(config: PI05UniforceConfig) -> int:
    """Return the number of state axes."""
    return config.input_features[STATE].shape[0]
