"""The policy: LeRobot's π0.5 whose prefix also holds force tokens, and whose actions follow the last command."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import torch
from huggingface_hub import ModelCard
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce import action, checkpoint, training, weights
from lerobot_policy_pi05_uniforce.augment import vary
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.model_card import CARD, model_card
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch, state_size
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE, floor_quantiles
from lerobot_policy_pi05_uniforce.touch.controls import SHAPES, TrueWrench
from lerobot_policy_pi05_uniforce.touch.encoder import ENCODER, check_hash, is_packaged
from lerobot_policy_pi05_uniforce.touch.felt import Felt
from lerobot_policy_pi05_uniforce.touch.sensors import PolicySensors
from lerobot_policy_pi05_uniforce.touch.touch_input import TouchInput
from lerobot_policy_pi05_uniforce.warm_up import LANGUAGE, WARM_LOOKS, made_up_batch
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION, STATE
from uniforce_vtla.markers import MARKER_IMAGES

logger = logging.getLogger(__name__)

# LeRobot's real-time chunking gives them
RTC_ARGUMENTS = frozenset(("prev_chunk_left_over", "inference_delay", "execution_horizon"))


class PI05UniforcePolicy(stock.PI05Policy):
    """π0.5 with a sense of force, as a LeRobot policy.

    Args:
        config: settings.
        dataset_stats: training statistics; quantile spans are floored in place, for the trainer's own normaliser too.
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
        **_: Any,
    ) -> None:
        PreTrainedPolicy.__init__(self, config)  # PI05Policy's own would build the 4 B model
        config.validate_features()
        self.config = config
        config.touch.marker_images = MARKER_IMAGES  # a checkpoint's was compared with it
        self.init_rtc_processor()
        self.model = PI05UniforcePytorch(config, rtc_processor=self.rtc_processor, empty=empty)
        self.touch = self._make_touch_input()
        self._take_dataset_facts(dataset_stats, dataset_meta)
        if config.gradient_checkpointing:
            self.model.gradient_checkpointing_enable()
        units = config.action.delta_scale, config.action.delta_knee
        action.check_axes(state_size(config), self._action_size, config.action)
        self.issued = action.IssuedTarget(config.action.previous_steps)
        self.register_buffer("delta_scale", torch.tensor(units[0]), persistent=False)
        self.register_buffer("leash", torch.tensor(config.action.leash), persistent=False)
        self.network_units = action.NetworkUnits(*units, chunk=config.chunk_size)
        bounds = config.action.target_range or [[-math.inf], [math.inf]]
        self.register_buffer("target_range", torch.tensor(bounds), persistent=False)
        if not empty:
            self.to(config.device)
        self.reset()

    def supports_rtc(self) -> bool:
        """Return whether LeRobot's real-time chunking fits: it feeds back absolute actions, which no deltas are."""
        return self.config.action.form == "absolute"

    def init_rtc_processor(self) -> None:
        """Take ``config.rtc_config`` in; ContractError where actions are deltas."""
        if self._rtc_enabled():
            self._refuse_rtc("rtc_config")
        super().init_rtc_processor()

    def _refuse_rtc(self, came: str) -> None:
        """Refuse real-time chunking of deltas: it also bypasses ``select_action``, which bounds leaps and leads."""
        if not self.supports_rtc():
            do = "Set inference.type=sync and leave rtc_config out, or train with action.form=absolute."
            raise ContractError(
                expected("actions as target_delta", "no real-time chunking", came, do)
            )

    def _make_touch_input(self) -> TouchInput:
        config = self.config
        frozen = self.model.tactile_encoder
        if config.touch.input == "wrench":
            return TrueWrench(config)
        if frozen is None:
            return TouchInput(config, (0, 0))
        shape = (config.tokens_per_slot, config.latent_size)
        if config.touch.input == "newtons":
            shape = SHAPES["newtons"]
        return TouchInput(config, shape, PolicySensors(config, frozen))

    def _take_dataset_facts(self, stats: dict[str, Any] | None, meta: Any) -> None:
        config, tokens = self.config, self.model.force_tokens
        training.read_view(meta, config)
        if meta is not None:
            training.read_provenance(meta, config)
            training.read_carried(meta, config, self.model.tactile_encoder)
        if not stats:
            return
        stats.update(floor_quantiles(stats))
        config.action.target_range = training.read_target_range(stats)
        found = training.read_touch_scale(stats, config, self.touch.shape)
        if found is not None and tokens is not None:
            tokens.input_mean.copy_(found[0])
            tokens.input_scale.copy_(found[1])

    @classmethod
    def from_pretrained(
        cls,
        pretrained_name_or_path: str | Path,
        *,
        config: PI05UniforceConfig | None = None,
        revision: str | None = None,
        local_files_only: bool = False,
        warm: bool = True,
        **kwargs: Any,
    ) -> PI05UniforcePolicy:
        """Load a checkpoint; every file must be as it was saved, every tensor fit, and nothing be left over.

        ``config.verify`` says how files are compared with their hashes. ``warm``: answer once before a robot is
        connected, unless training data in ``kwargs`` say that the policy isn't to act.

        Raises CheckpointError: missing, changed or damaged files, tensors that don't fit, touch settings that differ.
        """
        source, at = pretrained_name_or_path, (revision, local_files_only)
        verify = "full" if config is None else config.verify
        weights.check_files(source, verify, *at)
        # adapters have a folder of their own
        if config is not None and config.use_peft and config.pretrained_path:
            weights.check_files(
                config.pretrained_path, verify, config.pretrained_revision, local_files_only
            )
        where = weights.find(source, weights.CONFIG, *at)
        saved = read_object(where, CheckpointError)
        checkpoint.check_settings(saved, str(where))
        # of a hub repository: fetched before LeRobot does, and so checked first
        with suppress(CheckpointError):
            _ = [weights.find(source, name, *at) for name in checkpoint.PROCESSORS]
        checkpoint.check_processors(where.parent)
        with checkpoint.misfits_named(str(where)):
            if config is None:
                config = cls.config_class.from_pretrained(source, revision=revision)
            checkpoint.check_same(saved, config)
            policy = cls(config, empty=True, **kwargs)
        packaged = (ENCODER,) if is_packaged(config) else ()
        weights.fill(policy, weights.find(source, weights.WEIGHTS, *at), fresh=packaged)
        if policy.model.tactile_encoder is not None:
            check_hash(policy.model.tactile_encoder, config)
        policy.to(config.device).eval()
        if warm and not kwargs.keys() & {"dataset_stats", "dataset_meta"}:
            policy.warm_up()
        return policy

    @torch.no_grad()
    def warm_up(self) -> None:
        """Answer made-up observations, so that the first real ones don't wait for what is compiled or read once.

        A robot that is connected already would see a dead controller. Neither generators nor an episode are touched.
        """
        begun = time.perf_counter()
        batch = made_up_batch(self.config, self.leash.device)
        devices = [self.leash.device] if self.leash.is_cuda else []
        with torch.random.fork_rng(devices=devices):
            for _ in range(WARM_LOOKS):
                self.predict_action_chunk(batch)
        self.reset()
        logger.info(
            "policy warmed up in %.1f s, before any robot moves", time.perf_counter() - begun
        )

    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> Self:
        """Move every tensor, those of touch too: maps and ranges of sensors are no modules of this one."""
        before = self.leash.device
        super()._apply(fn, recurse)
        if self.leash.device != before:
            self.touch.to(self.leash.device)
            self.reset()
        return self

    def _save_pretrained(
        self, save_directory: Path, state_dict: dict[str, Tensor] | None = None
    ) -> None:
        """Write config, weights (a tactile tokenizer that isn't the package's among them) and a model card.

        LeRobot saves the processors later; who calls it calls ``write_hashes`` last.
        """
        drop_hashes(save_directory)
        state = self.state_dict() if state_dict is None else state_dict
        if is_packaged(self.config):
            state = {name: tensor for name, tensor in state.items() if not name.startswith(ENCODER)}
        super()._save_pretrained(save_directory, state)
        model_card(self.config).save(save_directory / CARD)

    def generate_model_card(self, *args: Any, cfg: Any = None, **kwargs: Any) -> ModelCard:
        """Return our card where LeRobot's trainer would push its own; arguments as LeRobot's, ``cfg`` is read."""
        return model_card(self.config, None if cfg is None else cfg.to_dict())

    def reset(self) -> None:
        """Forget the queue, the issued targets and the cached references: an episode begins."""
        super().reset()
        self.issued.reset()
        self.touch.reset()

    def _preprocess_images(self, batch: dict[str, Tensor]) -> tuple[list[Tensor], list[Tensor]]:
        cameras = self._shrunk(batch)  # marker images are none: see config.image_features
        images, masks = super()._preprocess_images(cameras)
        if self.training and self.config.augment.camera_variation:
            images = [vary(image, self.config.augment.camera_variation) for image in images]
        return images, masks

    def felt(self, batch: dict[str, Tensor]) -> Felt:
        """Return the state, with the previous action where the policy takes it, and touch.

        Raises as ``TouchInput.gather``.
        """
        device = self.leash.device
        state = None
        if self.model.state_token is not None:
            state = batch[STATE].to(device, torch.float32)
            if self.config.previous_axes:
                move = self._previous_move(batch)[:, self.config.previous_axes]
                state = torch.cat([state, move.to(state)], dim=1)
            state = state[:, None]  # (B, 1, S), or S + A with the previous action
        touches, touch_masks = self.touch.gather(batch, device, self.training)
        return Felt(state, tuple(touches), tuple(touch_masks))

    def _previous_move(self, batch: dict[str, Tensor]) -> Tensor:
        """Return (B, A) in units of ``delta_scale``: of a sample its demo's commands, of a rollout those issued."""
        commands = batch.get(ACTION)
        if commands is not None and commands.ndim == 3:
            return action.previous_move(commands.to(self.delta_scale)) / self.delta_scale
        return self.issued.moved(self._measured(batch)) / self.delta_scale

    def _shrunk(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Area-resize larger camera frames, as training views do; base keeps π0.5's own bilinear resize."""
        if self.config.size == "base":
            return batch
        size, shown = (
            self.config.image_resolution,
            [k for k in self.config.image_features if k in batch],
        )
        large = [k for k in shown if batch[k].shape[-1] > size[1]]
        return {**batch, **{k: F.interpolate(batch[k], size, mode="area") for k in large}}

    @property
    def _action_size(self) -> int:
        return self.config.output_features[ACTION].shape[0]

    def _text(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return text tokens and mask, (B, L); tiny drops the padding no prompt of the batch uses."""
        tokens, mask = (batch[key] for key in LANGUAGE)
        # base keeps one length, so that a compiled graph stays valid
        if self.config.size == "tiny":
            longest = int(mask.sum(dim=1).max())
            tokens, mask = tokens[:, :longest], mask[:, :longest]
        return tokens, mask

    def _measured(self, batch: dict[str, Tensor]) -> Tensor:
        if MEASURED_STATE not in batch:
            do = "Run the policy's own preprocessor (make_pi05_uniforce_pre_post_processors)."
            raise ContractError(
                expected(MEASURED_STATE, "the state in SI units", "no such key", do)
            )
        return batch[MEASURED_STATE].to(self.delta_scale)

    def prepare_action(self, batch: dict[str, Tensor]) -> Tensor:
        """Return (B, chunk, max_action_dim) in network units."""
        actions = batch[ACTION]
        if self.config.action.form == "target_delta":
            is_pad = batch.get("action_is_pad")
            known = actions.shape[1] - 1 - self.config.chunk_size  # commands before the last one
            is_pad = is_pad if is_pad is None else is_pad[:, known:]
            actions = action.to_deltas(
                actions[:, known:], is_pad, self._measured(batch), self.network_units
            )
        return stock.pad_vector(actions, self.config.max_action_dim)

    def forward(
        self, batch: dict[str, Tensor], reduction: str = "mean"
    ) -> tuple[Tensor, dict[str, Any]]:
        """Return the flow-matching loss over real steps and axes.

        Args:
            batch: preprocessed observations, text tokens and actions (B, [1 +] chunk, A).
            reduction: "mean" → scalar; "none" → (B,) for weighted training.
        """
        images, masks = self._preprocess_images(batch)
        felt = self.felt(batch)
        actions = self.prepare_action(batch)
        noise, time = self._flow_start(actions)
        tokens, text_mask = self._text(batch)
        flow = {"actions": actions, "noise": noise, "time": time}
        losses = self.model.forward(images, masks, tokens, text_mask, felt, **flow)
        losses = losses[:, :, : self._action_size]  # (B, chunk, A)
        is_pad = batch.get("action_is_pad", torch.zeros_like(actions[..., 0], dtype=torch.bool))
        keep = (~is_pad[:, -losses.shape[1] :]).to(losses)[..., None]  # (B, chunk, 1)
        axes = None if reduction == "mean" else (1, 2)
        loss = (losses * keep).sum(axes) / (keep.sum(axes) * self._action_size).clamp_min(1)
        facts = {
            "loss": float(loss.detach().mean()),
            "target_rms": float(actions.square().mean().sqrt()),
        }
        return loss, facts

    def _flow_start(self, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return noise (B, chunk, ·) and flow time (B,): random for flow matching."""
        if self.config.action.objective == "regression":
            # the flow's first step from zero noise: its velocity is minus the action, one Euler step samples it
            return torch.zeros_like(actions), actions.new_ones(len(actions))
        noise = self.model.sample_noise(actions.shape, actions.device)
        return noise, self.model.sample_time(len(actions), actions.device)

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Return (B, chunk, A) actions for the postprocessor: absolute targets whatever the action form.

        Raises ContractError: arguments of real-time chunking, where actions are deltas.
        """
        if (chunking := RTC_ARGUMENTS & kwargs.keys()) or self._rtc_enabled():
            self._refuse_rtc(", ".join(sorted(chunking)) or "rtc_config")
        self._notice_adapters()
        tokens, mask = self._text(batch)
        batch = {**batch, LANGUAGE[0]: tokens, LANGUAGE[1]: mask}
        start = self._start_noise(len(tokens), tokens.device)
        if self.config.action.objective == "regression":
            kwargs["noise"] = start  # zeros whatever was asked for: it was trained on nothing else
        kwargs.setdefault("noise", start)
        kwargs["felt"] = self.felt(batch)
        return self._targets(super().predict_action_chunk(batch, **kwargs), batch)

    def _notice_adapters(self) -> None:
        """Let LeRobot's loop sample while PEFT's adapters are in: the fast one reads plain weights."""
        adapted = hasattr(self, "peft_config")
        if adapted and not self.model.adapted and self.model.fast is not None:
            logger.warning(
                "LoRA isn't merged: LeRobot's loop samples, slowly. uniforce share merges it."
            )
        self.model.adapted = adapted

    def _targets(self, chunk: Tensor, batch: dict[str, Tensor]) -> Tensor:
        """Return what the postprocessor takes: the network's chunk, deltas put on the last command."""
        if self.config.action.form == "absolute":
            return chunk
        targets = action.to_targets(
            chunk, self.issued.base(self._measured(batch)), self.network_units
        )
        # changes could add up to places no demo has shown
        return targets.clamp(*self.target_range.to(targets))

    def _start_noise(self, batch_size: int, device: torch.device) -> Tensor:
        """Return where the flow starts, (B, chunk, max_action_dim): scaled noise; 0 gives the central action."""
        shape = (batch_size, self.config.chunk_size, self.config.max_action_dim)
        return self.config.sampler.noise_scale * self.model.sample_noise(shape, device)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], steps: int = 0, **kwargs: Any) -> Tensor:
        """Return the next (B, A) action and remember it.

        Args:
            batch: preprocessed observations.
            steps: control steps since they were made; LeRobot observes at each one, which is 0.
            kwargs: LeRobot's own, without effect here.

        Raises RolloutError: target deltas leap, or the arm is far outside the demos; nothing is issued.
        """
        before = self.issued.asked if self._action_queue else self.issued.last
        # a queued action needs no network, and LeRobot's look at every module's mode takes milliseconds
        target = (
            self._action_queue.popleft() if self._action_queue else super().select_action(batch)
        )
        if self.config.action.form == "target_delta":
            target = self._bounded(target, before, self._measured(batch), steps)
        self.issued.record(target)
        return target

    def _bounded(
        self, target: Tensor, before: Tensor | None, measured: Tensor, steps: int
    ) -> Tensor:
        """Return a (B, A) target on its leash, so that the next chunk doesn't wind up; raises as ``select_action``."""
        action.check_leap(target, before, self.delta_scale)
        bounded = action.on_leash(target, measured, self.leash, steps)
        if action.stops_outside(self.config.action.stop_outside_demos):
            action.check_within(bounded, *self.target_range)
        self.issued.asked = target
        return bounded

    def train(self, mode: bool = True) -> Self:
        """Set the mode of every module; LeRobot asks for evaluation at every step, which costs milliseconds each."""
        if not mode and not any(module.training for module in self.modules()):
            return self
        return super().train(mode)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return trainable parameters in groups: the backbone, what starts random, the gate of touch."""
        return training.parameter_groups(self.named_parameters(), self.config)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return training.lora_targets(self.model)
