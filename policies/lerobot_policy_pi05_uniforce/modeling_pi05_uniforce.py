"""The policy: LeRobot's π0.5 whose prefix also holds force tokens, and whose actions follow the last command."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import torch
from huggingface_hub import ModelCard
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce import weights
from lerobot_policy_pi05_uniforce.action_form import (
    IssuedTarget,
    NetworkUnits,
    TargetRange,
    check_axes,
    to_targets,
    told_move,
)
from lerobot_policy_pi05_uniforce.action_loss import LANGUAGE, ActionLoss
from lerobot_policy_pi05_uniforce.camera_variation import vary
from lerobot_policy_pi05_uniforce.check_action import check_leap
from lerobot_policy_pi05_uniforce.compatibility import TouchFacts, check_same
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.dataset_facts import (
    read_provenance,
    read_target_range,
    read_touch_scale,
    read_view,
)
from lerobot_policy_pi05_uniforce.force_tokens import ForceTokens
from lerobot_policy_pi05_uniforce.model_card import CARD, model_card
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch, state_size
from lerobot_policy_pi05_uniforce.quantile_floor import floor_quantiles
from lerobot_policy_pi05_uniforce.stored_settings import (
    PROCESSORS,
    check_processors,
    check_settings,
    misfits_named,
)
from lerobot_policy_pi05_uniforce.tactile_encoder import check_hash
from lerobot_policy_pi05_uniforce.touch_input import TouchInput
from lerobot_policy_pi05_uniforce.trainable import NEW_MODULES, lora_targets, parameter_groups
from lerobot_policy_pi05_uniforce.transferred_touch import transferred_touch
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.keys import ACTION, STATE

logger = logging.getLogger(__name__)


class PI05UniforcePolicy(ActionLoss):
    """π0.5 with a sense of force, as a LeRobot policy.

    Args:
        config: settings; ``config.touch_slots`` and ``swap`` say which finger fills which slot.
        dataset_stats: training statistics; quantile spans are floored in place, so that the trainer's own
            normaliser uses the same ones, and the scale of the latents is taken from it.
        dataset_meta: training data; a view's tokenizer must be the policy's.
        empty: leave the backbone without weights, for ``weights.fill`` to give it; base is then never held twice.
    """

    config_class = PI05UniforceConfig
    name = "pi05_uniforce"

    def __init__(
        self,
        config: PI05UniforceConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any = None,
        empty: bool = False,
        **kwargs: Any,
    ) -> None:
        PreTrainedPolicy.__init__(self, config)  # PI05Policy's own would build the 4 B model
        config.validate_features()
        self.config = config
        self.init_rtc_processor()
        self.model = PI05UniforcePytorch(config, rtc_processor=self.rtc_processor, empty=empty)
        self._take_dataset_facts(dataset_stats, dataset_meta)
        if config.gradient_checkpointing:
            self.model.gradient_checkpointing_enable()
        if config.action_form == "target_delta":
            check_axes(state_size(config), self._action_size, config.delta_scale, config.delta_knee)
        self.touch = TouchInput(config, self.model.tactile_encoder)
        self.issued = IssuedTarget(config.last_move_steps)
        self.register_buffer("delta_scale", torch.tensor(config.delta_scale), persistent=False)
        self.network_units = NetworkUnits(config.delta_scale, config.delta_knee)
        bounds = config.target_range if config.keep_inside_demos else ()
        self.target_range = TargetRange(len(config.delta_scale), bounds)
        if not empty:
            self.to(config.device)
        self.reset()

    def _take_dataset_facts(self, stats: dict[str, Any] | None, meta: Any) -> None:
        read_view(meta, self.config)
        if meta is not None:
            read_provenance(meta, self.config)
            self._prepare_transfer()
        if not stats:
            return
        stats.update(floor_quantiles(stats) or {})
        self.config.target_range = read_target_range(stats)
        found = read_touch_scale(stats, self.config)
        if found is not None and self.model.force_tokens is not None:
            mean, scale = found
            self.model.force_tokens.input_mean.copy_(mean)
            self.model.force_tokens.input_scale.copy_(scale)

    def _prepare_transfer(self) -> None:
        tokens = self.model.force_tokens
        if self.config.sensor_transfer and isinstance(tokens, ForceTokens):
            tokens.transferred = transferred_touch(self.config)

    @classmethod
    def from_pretrained(
        cls,
        pretrained_name_or_path: str | Path,
        *,
        config: PI05UniforceConfig | None = None,
        revision: str | None = None,
        local_files_only: bool = False,
        **kwargs: Any,
    ) -> PI05UniforcePolicy:
        """Load a checkpoint; every file must be as it was saved, every tensor fit, and nothing be left over.

        ``config.verify`` says how files are compared with their hashes.

        Raises:
            CheckpointError: missing, changed or damaged files, tensors that don't fit, touch settings that differ.
        """
        source, verify = pretrained_name_or_path, "full" if config is None else config.verify
        weights.check_files(source, verify, revision, local_files_only)
        if (
            config is not None and config.use_peft and config.pretrained_path
        ):  # adapters lie in a folder of their own
            weights.check_files(config.pretrained_path, verify, config.pretrained_revision, local_files_only)
        where = weights.find(source, weights.CONFIG, revision, local_files_only)
        saved = weights.read_config(where)
        check_settings(saved, str(where))
        for (
            name
        ) in PROCESSORS:  # of a hub repository: fetched before LeRobot does, so that they are checked first
            with suppress(CheckpointError):
                weights.find(source, name, revision, local_files_only)
        check_processors(where.parent)
        with misfits_named(str(where)):
            if config is None:
                config = cls.config_class.from_pretrained(source, revision=revision)
            check_same(TouchFacts.of(saved), TouchFacts.of(config))
            policy = cls(config, empty=True, **_known(kwargs))
        weights.fill(policy, weights.find(source, weights.WEIGHTS, revision, local_files_only))
        if policy.model.tactile_encoder is not None:
            check_hash(policy.model.tactile_encoder, config)
        return policy.to(config.device).eval()

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        """Write config, weights (the frozen tactile tokenizer among them) and a model card.

        LeRobot saves the processors later; who calls it calls ``write_hashes`` last.
        """
        drop_hashes(save_directory)
        super()._save_pretrained(save_directory, state_dict)
        model_card(self.config).save(save_directory / CARD)

    def generate_model_card(self, *args: Any, cfg: Any = None, **kwargs: Any) -> ModelCard:
        """Return our card where LeRobot's trainer would push its own; arguments as LeRobot's, ``cfg`` is read."""
        return model_card(self.config, training=None if cfg is None else cfg.to_dict())

    def reset(self) -> None:
        """Forget the queue, the issued targets and the cached references: an episode begins."""
        super().reset()
        if hasattr(self, "issued"):
            self.issued.reset()
            self.touch.reset()

    def _preprocess_images(self, batch: dict[str, Tensor]) -> tuple[list[Tensor], list[Tensor]]:
        images, masks = super()._preprocess_images(
            self._shrunk(batch)
        )  # cameras only: see config.image_features
        if self.training:
            images = [vary(image, self.config.camera_variation) for image in images]
        if self.model.state_token is not None:
            state = batch[STATE].to(images[0].device, torch.float32)
            if self.config.last_move_steps:
                told = self._last_move(batch)[:, self.config.told_axes]
                state = torch.cat([state, told.to(state)], dim=1)
            images.append(state[:, None])  # (B, 1, S), or S + A with the last move
            masks.append(torch.ones(len(state), dtype=torch.bool, device=state.device))
        touches, touch_masks = self.touch.gather(batch, images[0].device, self.training)
        return images + touches, masks + touch_masks

    def _last_move(self, batch: dict[str, Tensor]) -> Tensor:
        """Return (B, A) in units of ``delta_scale``: of a sample its demo's commands, of a rollout those issued."""
        commands = batch.get(ACTION)
        if commands is not None and commands.ndim == 3:
            return told_move(commands.to(self.delta_scale)) / self.delta_scale
        return self.issued.moved(self._measured(batch)) / self.delta_scale

    def _shrunk(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Area-resize larger camera frames, as training views do; base keeps π0.5's own bilinear resize."""
        if self.config.size == "base":
            return batch
        size = self.config.image_resolution
        cameras = {
            k: batch[k] for k in self.config.image_features if k in batch and batch[k].shape[-1] > size[1]
        }
        return {**batch, **{k: F.interpolate(image, size, mode="area") for k, image in cameras.items()}}

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Return (B, chunk, A) actions for the postprocessor: absolute targets whatever the action form."""
        self._notice_adapters()
        tokens, mask = self._text(batch)
        batch = {**batch, LANGUAGE[0]: tokens, LANGUAGE[1]: mask}
        start = self._start_noise(len(tokens), tokens.device)
        if self.config.action_objective == "regression":
            kwargs["noise"] = start  # zeros whatever was asked for: it was trained on nothing else
        kwargs.setdefault("noise", start)
        return self._targets(super().predict_action_chunk(batch, **kwargs), batch)

    @torch.no_grad()
    def refresh_action_chunk(self, batch: dict[str, Tensor]) -> Tensor:
        """Return (B, chunk, A) for what is felt now and what was seen at the last ``predict_action_chunk``.

        Cameras and text are not looked at: only the flow runs again, on the prefix as it was (``token_site=suffix``).

        Args:
            batch: preprocessed; touch and the measured state are read.

        Raises:
            ContractError: touch that isn't in the suffix, the stock sampler, or nothing predicted before.
        """
        self.eval()
        device = self.delta_scale.device
        felt = self.model.felt_now(*self.touch.gather(batch, device, training=False))
        self._notice_adapters()
        if felt is None or self.model.fast is None or self.model.adapted:
            came = f"touch_input={self.config.touch_input}, sampler={self.config.sampler}, LoRA {self.model.adapted}"
            do = "Only touch can be refreshed, by the fast sampler; uniforce-share merges LoRA."
            raise ContractError(expected("refresh", "touch and sampler=fast", came, do))
        noise = self._start_noise(len(felt.tokens), device)
        chunk = self.model.fast.refresh(felt, noise, self.config.num_inference_steps)[
            ..., : self._action_size
        ]
        return self._targets(chunk, batch)

    def _notice_adapters(self) -> None:
        """Let LeRobot's loop sample while PEFT's adapters are in: the fast one reads plain weights."""
        adapted = hasattr(self, "peft_config")
        if adapted and not self.model.adapted and self.model.fast is not None:
            logger.warning(
                "LoRA isn't merged: LeRobot's loop samples, at its speed. uniforce-share merges it."
            )
        self.model.adapted = adapted

    def _targets(self, chunk: Tensor, batch: dict[str, Tensor]) -> Tensor:
        """Return what the postprocessor takes: the network's chunk, deltas put on the last command."""
        if self.config.action_form == "absolute":
            return chunk
        targets = to_targets(chunk, self.issued.base(self._measured(batch)), self.network_units)
        return self.target_range.kept(targets)

    def _start_noise(self, batch_size: int, device: torch.device) -> Tensor:
        """Return where the flow starts, (B, chunk, max_action_dim): scaled noise; 0 gives the central action."""
        shape = (batch_size, self.config.chunk_size, self.config.max_action_dim)
        return self.config.sampling_noise * self.model.sample_noise(shape, device)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Return the next (B, A) action and remember it as the base of the next chunk.

        Raises:
            RolloutError: target deltas that leap; nothing is issued.
        """
        # a queued action needs no network, and LeRobot's look at every module's mode takes milliseconds
        action = self._action_queue.popleft() if self._action_queue else super().select_action(batch)
        if self.config.action_form == "target_delta":
            check_leap(action, self.issued.last, self.delta_scale)
        self.issued.record(action)
        return action

    def train(self, mode: bool = True) -> Self:
        """Set the mode of every module; LeRobot asks for evaluation at every step, which costs milliseconds each."""
        if not mode and not any(module.training for module in self.modules()):
            return self
        return super().train(mode)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return trainable parameters in groups: the backbone, what starts random, the gate of touch."""
        return parameter_groups(self.named_parameters(), self.config)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        new = [name for name in NEW_MODULES if getattr(self.model, name) is not None]
        return lora_targets(self.model, new)


def _known(kwargs: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in kwargs.items() if k in ("dataset_stats", "dataset_meta")}
