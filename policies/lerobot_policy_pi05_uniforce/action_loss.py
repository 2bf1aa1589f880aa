"""What training asks of the policy: actions in network units, and the loss of the chunk they make."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor

from lerobot_policy_pi05_uniforce.action_form import to_deltas
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import ACTION

LANGUAGE = ("observation.language.tokens", "observation.language.attention_mask")


class ActionLoss(stock.PI05Policy):
    """π0.5 with our action forms and objectives; ``PI05UniforcePolicy`` builds it."""

    @property
    def _action_size(self) -> int:
        return self.config.output_features[ACTION].shape[0]

    def _text(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return text tokens and mask, (B, L); tiny drops the padding no prompt of the batch uses."""
        tokens, mask = (batch[key] for key in LANGUAGE)
        if self.config.size == "tiny":  # base keeps one length, so that a compiled graph stays valid
            longest = int(mask.sum(dim=1).max())
            tokens, mask = tokens[:, :longest], mask[:, :longest]
        return tokens, mask

    def prepare_action(self, batch: dict[str, Tensor]) -> Tensor:
        """Return (B, chunk, max_action_dim) in network units."""
        actions = batch[ACTION]
        if self.config.action_form == "target_delta":
            is_pad = batch.get("action_is_pad")
            known = actions.shape[1] - 1 - self.config.chunk_size  # commands before the last one
            is_pad = is_pad if is_pad is None else is_pad[:, known:]
            actions = to_deltas(actions[:, known:], is_pad, self._measured(batch), self.network_units)
        return stock.pad_vector(actions, self.config.max_action_dim)

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict[str, Any]]:
        """Return the flow-matching loss over real steps and axes.

        Args:
            batch: preprocessed observations, text tokens and actions (B, [1 +] chunk, A).
            reduction: "mean" → scalar; "none" → (B,) for weighted training.
        """
        images, masks = self._preprocess_images(batch)
        actions = self.prepare_action(batch)
        noise, time = self._flow_start(actions)
        losses = self.model.forward(images, masks, *self._text(batch), actions, noise, time)
        losses = losses[:, :, : self._action_size]  # (B, chunk, A)
        keep = self._real_steps(batch, losses)  # (B, chunk, 1)
        per_sample = (losses * keep).sum(dim=(1, 2)) / (keep.sum(dim=(1, 2)) * self._action_size).clamp_min(1)
        loss = (
            per_sample
            if reduction == "none"
            else (losses * keep).sum() / (keep.sum() * self._action_size).clamp_min(1)
        )
        facts = {"loss": float(loss.detach().mean()), "target_rms": float(actions.square().mean().sqrt())}
        told = self.model.next_force_loss(batch)
        if told is not None:
            loss = loss + self.config.next_force_weight * (told if reduction == "none" else told.mean())
            facts["next_force_loss"] = float(told.detach().mean())
        return loss, facts

    def _flow_start(self, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return noise (B, chunk, ·) and flow time (B,): random for flow matching.

        Regression is the flow's first step from zero noise: its velocity there is minus the action itself, the squared
        error is the action's, and one Euler step samples it.
        """
        if self.config.action_objective == "regression":
            return torch.zeros_like(actions), actions.new_ones(len(actions))
        noise = self.model.sample_noise(actions.shape, actions.device)
        return noise, self.model.sample_time(len(actions), actions.device)

    def _real_steps(self, batch: dict[str, Tensor], losses: Tensor) -> Tensor:
        is_pad = batch.get("action_is_pad")
        if is_pad is None:
            return losses.new_ones(*losses.shape[:2], 1)
        return (~is_pad[:, -losses.shape[1] :]).to(losses)[..., None]

    def _measured(self, batch: dict[str, Tensor]) -> Tensor:
        if MEASURED_STATE not in batch:
            do = "Run the policy's own preprocessor (make_pi05_uniforce_pre_post_processors)."
            raise ContractError(expected(MEASURED_STATE, "the state in SI units", "no such key", do))
        return batch[MEASURED_STATE].to(self.delta_scale)
