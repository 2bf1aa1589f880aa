"""The policy: LeRobot's π0.5 with force tokens, whose actions follow the last command."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import torch
from huggingface_hub import ModelCard, save_torch_state_dict
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from tqdm import tqdm

from lerobot_policy_pi05_uniforce import action, checkpoint, training, weights
from lerobot_policy_pi05_uniforce.augment import vary
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.model_card import CARD, model_card
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch, drop_padding
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE, floor_quantiles
from lerobot_policy_pi05_uniforce.sampler.fast import BUCKETS, FastSampler
from lerobot_policy_pi05_uniforce.touch.encoder import ENCODER, check_hash, is_packaged
from lerobot_policy_pi05_uniforce.touch.sensors import policy_sensors
from lerobot_policy_pi05_uniforce.touch.tokens import Felt
from lerobot_policy_pi05_uniforce.touch.touch_input import PAIR_KEYS, Batch, TouchInput
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION, STATE, wrench_key
from uniforce_vtla.markers import MARKER_IMAGES

logger = logging.getLogger(__name__)

ONE_FILE = "1TB"  # weights are never split over several files
# LeRobot's real-time chunking gives them
RTC_ARGUMENTS = frozenset(("prev_chunk_left_over", "inference_delay", "execution_horizon"))
# the second one finds the reference in memory; a health monitor judges from the third on
WARM_READINGS = 2


class PI05UniforcePolicy(stock.PI05Policy):
    """π0.5 with a sense of force, as a LeRobot policy.

    Args:
        config: settings.
        dataset_stats: training statistics; left as they are.
        dataset_meta: training data; a view's tokenizer must be the policy's. Its ``stats`` become a
            copy with floored quantile spans: LeRobot's trainer hands those to a stored normaliser.
        empty: leave the backbone without weights, for ``weights.fill``: base is never held twice.
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
        self.model = PI05UniforcePytorch(config, self.rtc_processor, empty)
        if config.sampler.kind != "stock":
            self.model.fast = FastSampler(self.model)
        self.touch = TouchInput(config, policy_sensors(config, self.model.tactile_encoder))
        self._take_dataset_facts(dataset_stats, dataset_meta)
        if config.gradient_checkpointing:
            self.model.gradient_checkpointing_enable()
        settings = config.action
        self._action_size = config.output_features[ACTION].shape[0]
        action.check_axes(config.state_size, self._action_size, settings)
        self.issued = action.IssuedTarget()
        self.network_units = action.NetworkUnits(
            settings.delta_scale, settings.delta_knee, config.chunk_size
        )
        bounds = settings.target_range or [[-math.inf], [math.inf]]
        self.register_buffer("delta_scale", torch.tensor(settings.delta_scale), persistent=False)
        self.register_buffer("leash", torch.tensor(settings.leash), persistent=False)
        self.register_buffer("target_range", torch.tensor(bounds), persistent=False)
        if not empty:
            self.to(config.device)
        self.reset()

    def supports_rtc(self) -> bool:
        """Return whether LeRobot's real-time chunking fits: it feeds back absolute actions."""
        return self.config.action.form == "absolute"

    def init_rtc_processor(self) -> None:
        """Take ``config.rtc_config`` in; ContractError: actions are deltas, or its mode is new."""
        if self._rtc_enabled():
            self._refuse_rtc("rtc_config")
            mode = getattr(self.config.rtc_config, "mode", "guided")  # LeRobot 0.6 has no other
            if mode != "guided":
                do = "Set inference.rtc.mode=guided."
                raise ContractError(expected("rtc_config.mode", "guided", mode, do))
        super().init_rtc_processor()

    def _refuse_rtc(self, came: str) -> None:
        """Refuse chunking of deltas: it bypasses ``select_action``, which bounds leaps, leads."""
        if not self.supports_rtc():
            name = "actions as target_delta"
            do = (
                "Set inference.type=sync and leave rtc_config out, "
                "or train with action.form=absolute."
            )
            raise ContractError(expected(name, "no real-time chunking", came, do))

    def _take_dataset_facts(self, stats: dict[str, Any] | None, meta: Any) -> None:
        config = self.config
        if meta is not None:
            training.refuse_force_in_state(meta)
            training.refuse_unseen_fingers(meta, config)
            training.read_view(meta, config)
            training.read_latent_columns(meta, config)
            training.read_provenance(meta, config)
        if stats:
            if meta is not None:
                # fine-tuning skips our processor factory, and asks the policy for no statistics
                meta.stats = floor_quantiles(stats)
            config.action.target_range = training.read_target_range(stats)
            scale = training.read_touch_scale(stats, config)
            if scale is not None:
                self.model.force_tokens.input_mean.copy_(scale[0])
                self.model.force_tokens.input_scale.copy_(scale[1])

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
        """Load a checkpoint; every file must be as saved, every tensor fit, nothing be left over.

        ``config.verify`` says how files are compared with their hashes. ``warm``: answer once
        before a robot is connected, unless training data in ``kwargs`` say that it isn't to act.

        Raises CheckpointError: missing, changed or damaged files, tensors that don't fit, touch
        settings that differ.
        """
        source = pretrained_name_or_path
        at = (revision, local_files_only)
        verify = config.verify if config else "full"
        weights.check_files(source, verify, *at)
        if config and config.use_peft and config.pretrained_path:  # adapters have their own folder
            adapters = config.pretrained_path
            weights.check_files(adapters, verify, config.pretrained_revision, local_files_only)
        where = weights.find(source, weights.CONFIG, *at)
        saved = read_object(where, CheckpointError)
        checkpoint.check_settings(saved, str(where))
        # of a hub repository: fetched before LeRobot does, and so checked first
        with suppress(CheckpointError):
            for name in checkpoint.PROCESSORS:
                weights.find(source, name, *at)
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
        """Answer made-up observations, so that the first real ones don't wait for compilation.

        A robot that is connected already would see a dead controller. Neither generators nor an
        episode are touched. With CUDA graphs there is one for each length of text, and the first is
        compiled.
        """
        begun = time.perf_counter()
        device = self.leash.device
        batch = made_up_batch(self.config, device)
        fast = self.model.fast
        lengths = {self.config.tokenizer_max_length}
        is_graphed = False
        if fast is not None:
            is_graphed = fast.is_graphed_on(device)
            fast.compiles = is_graphed
        if is_graphed:
            lengths |= {size for size in BUCKETS if size < self.config.tokenizer_max_length}
        bar = tqdm(sorted(lengths, reverse=True), "compiling", disable=not is_graphed, unit="graph")
        with torch.random.fork_rng(devices=[device] if self.leash.is_cuda else []):
            for length in bar:
                batch[OBS_LANGUAGE_ATTENTION_MASK][:, length:] = False
                for _ in range(WARM_READINGS):
                    self.predict_action_chunk(batch)
                self.reset()
        if fast is not None:
            fast.compiles = False
        took_s = time.perf_counter() - begun
        logger.info("policy warmed up in %.1f s, before any robot moves", took_s)

    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> Self:
        """Move touch as well: maps and ranges of sensors are no modules of this one."""
        before = self.leash.device
        super()._apply(fn, recurse)
        if self.leash.device != before:
            self.touch.to(self.leash.device)
            self.reset()
        return self

    def _save_pretrained(
        self, save_directory: Path, state_dict: dict[str, Tensor] | None = None
    ) -> None:
        """Write config, weights and a model card; the package's own tokenizer is left out.

        LeRobot saves the processors later; who calls it calls ``write_hashes`` last.
        """
        drop_hashes(save_directory)
        state = self.state_dict() if state_dict is None else state_dict
        if is_packaged(self.config):
            state = {name: tensor for name, tensor in state.items() if not name.startswith(ENCODER)}
        self.config._save_pretrained(save_directory)
        save_torch_state_dict(state, save_directory, max_shard_size=ONE_FILE)
        model_card(self.config).save(save_directory / CARD)

    def generate_model_card(self, *args: Any, cfg: Any = None, **kwargs: Any) -> ModelCard:
        """Return our card where LeRobot's trainer would push its own; ``cfg`` alone is read."""
        return model_card(self.config, cfg and cfg.to_dict())

    def reset(self) -> None:
        """Forget the queue, the issued targets and the cached references: an episode begins."""
        super().reset()
        self.issued.reset()
        self.touch.reset()

    def _preprocess_images(self, batch: Batch) -> tuple[list[Tensor], list[Tensor]]:
        """Return camera images and masks, from floats in [0, 1] or uint8; training varies them.

        Larger frames of ``tiny`` are resized by area, as training views; base keeps π0.5's resize.
        """
        size = self.config.image_resolution
        frames = dict(batch)
        for key in self.config.image_features.keys() & batch.keys():  # no marker images
            image = batch[key].to(self.leash.device)
            if image.dtype == torch.uint8:  # a quarter of the bytes on their way to the device
                image = image / 255
            if self.config.size == "tiny" and image.shape[-1] > size[1]:
                image = F.interpolate(image, size, mode="area")
            frames[key] = image
        images, masks = super()._preprocess_images(frames)
        if self.training and self.config.augment.camera_variation:
            images = [vary(image, self.config.augment.camera_variation) for image in images]
        return images, masks

    def felt(self, batch: Batch, watched: bool = True) -> Felt:
        """Return touch and, for a state token, the state; raises as ``TouchInput.gather``."""
        state = None
        if self.model.state_token is not None:
            state = batch[STATE].to(self.leash)[:, None]  # (B, 1, S)
        return Felt(state, *self.touch.gather(batch, self.training, watched))

    def _measured(self, batch: Batch) -> Tensor:
        if MEASURED_STATE not in batch:
            wanted = "the state in SI units"
            do = "Run the policy's own preprocessor (make_pi05_uniforce_pre_post_processors)."
            raise ContractError(expected(MEASURED_STATE, wanted, "no such key", do))
        return batch[MEASURED_STATE].to(self.delta_scale)

    def prepare_action(self, batch: Batch) -> Tensor:
        """Return (B, chunk, max_action_dim) in network units."""
        actions = batch[ACTION]
        if self.config.action.form == "target_delta":
            is_pad = batch.get("action_is_pad")
            measured = self._measured(batch)
            actions = action.to_deltas(actions, is_pad, measured, self.network_units)
        return stock.pad_vector(actions, self.config.max_action_dim)

    def forward(self, batch: Batch, reduction: str = "mean") -> tuple[Tensor, dict[str, Any]]:
        """Return the flow-matching loss over real steps and axes.

        Args:
            batch: preprocessed observations, text tokens and actions (B, [1 +] chunk, A).
            reduction: "mean" → scalar; "none" → (B,) for weighted training.
        """
        images, masks = self._preprocess_images(batch)
        felt = self.felt(batch, watched=False)  # also of LeRobot's held-out data
        actions = self.prepare_action(batch)  # (B, chunk, max_action_dim)
        if self.config.action.objective == "regression":
            # The flow's first step from zero noise: its velocity is minus the action, and one Euler
            # step samples it.
            noise = torch.zeros_like(actions)
            flow_time = actions.new_ones(len(actions))
        else:
            noise = self.model.sample_noise(actions.shape, actions.device)
            flow_time = self.model.sample_time(len(actions), actions.device)
        tokens = batch[OBS_LANGUAGE_TOKENS]
        text_mask = batch[OBS_LANGUAGE_ATTENTION_MASK]
        flow = {"actions": actions, "noise": noise, "time": flow_time}
        losses = self.model.forward(images, masks, tokens, text_mask, felt, **flow)
        losses = losses[:, :, : self._action_size]  # (B, chunk, A)
        keep = torch.ones_like(losses[..., :1])  # (B, chunk, 1)
        if "action_is_pad" in batch:
            is_pad = batch["action_is_pad"][:, -losses.shape[1] :, None]
            keep = (~is_pad).to(losses)
        axes = None if reduction == "mean" else (1, 2)
        loss = (losses * keep).sum(axes) / (keep.sum(axes) * self._action_size).clamp_min(1)
        facts = {
            "loss": float(loss.detach().mean()),
            "target_rms": float(actions.square().mean().sqrt()),
        }
        return loss, facts

    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch, **kwargs: Any) -> Tensor:
        """Return (B, chunk, A) actions for the postprocessor: absolute targets in either form.

        Raises ContractError: arguments of real-time chunking, where actions are deltas.
        """
        chunking = sorted(RTC_ARGUMENTS & kwargs.keys())
        if chunking or self._rtc_enabled():
            self._refuse_rtc(", ".join(chunking) or "rtc_config")
        self._notice_adapters()
        tokens = batch[OBS_LANGUAGE_TOKENS]
        # base keeps one length, so that a compiled graph stays valid
        if self.config.size == "tiny":
            tokens, mask = drop_padding(tokens, batch[OBS_LANGUAGE_ATTENTION_MASK])
            batch = {**batch, OBS_LANGUAGE_TOKENS: tokens, OBS_LANGUAGE_ATTENTION_MASK: mask}
        shape = (len(tokens), self.config.chunk_size, self.config.max_action_dim)
        # scaled noise; 0 gives the central action
        noise = self.config.sampler.noise_scale * self.model.sample_noise(shape, tokens.device)
        if self.config.action.objective == "regression":
            kwargs["noise"] = noise  # zeros whatever was asked for: it was trained on nothing else
        kwargs.setdefault("noise", noise)
        chunk = super().predict_action_chunk(batch, felt=self.felt(batch), **kwargs)
        if self.config.action.form == "absolute":
            return chunk
        base = self.issued.base(self._measured(batch))
        targets = action.to_targets(chunk, base, self.network_units)
        # changes could add up to places no demo has shown
        return targets.clamp(*self.target_range.to(targets))

    def _notice_adapters(self) -> None:
        """Let LeRobot's loop sample with PEFT's adapters in: the fast one reads plain weights."""
        adapted = hasattr(self, "peft_config")
        if adapted and not self.model.adapted and self.model.fast is not None:
            message = "LoRA isn't merged: LeRobot's loop samples, slowly. uniforce share merges it."
            logger.warning(message)
        self.model.adapted = adapted

    @torch.no_grad()
    def select_action(self, batch: Batch, steps: int = 0, **kwargs: Any) -> Tensor:
        """Return the next (B, A) action and remember it.

        A target is kept on its leash, so that the next chunk doesn't wind up.

        Args:
            batch: preprocessed observations.
            steps: control steps since they were made; LeRobot observes at each one, which is 0.
            kwargs: LeRobot's own, without effect here.

        Raises RolloutError: deltas leap, or the arm is far outside the demos; nothing is issued.
        """
        if self._action_queue:
            # needs no network, and LeRobot's look at every module's mode takes milliseconds
            before = self.issued.asked
            target = self._action_queue.popleft()
        else:
            before = self.issued.last
            target = super().select_action(batch)
        if self.config.action.form == "target_delta":
            asked = target
            action.check_leap(asked, before, self.delta_scale)
            target = action.on_leash(asked, self._measured(batch), self.leash, steps)
            if action.stops_outside(self.config.action.stop_outside_demos):
                action.check_within(target, *self.target_range)
            self.issued.asked = asked
        self.issued.record(target)
        return target

    def train(self, mode: bool = True) -> Self:
        """Set the mode of every module; LeRobot's evaluation mode at every step costs little."""
        if mode or _trains(self):
            return super().train(mode)
        return self

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return trainable parameters in groups: the backbone, new modules, the gate of touch."""
        return training.parameter_groups(self.named_parameters(), self.config)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return training.lora_targets(self.model)


def _trains(module: torch.nn.Module) -> bool:
    """Return whether a module, or one inside it, is in training mode."""
    return module.training or any(map(_trains, module.children()))


def made_up_batch(config: PI05UniforceConfig, device: torch.device) -> Batch:
    """Return a meaningless batch of one, as the preprocessor of ``config`` would give it."""
    state = config.input_features[STATE].shape
    shapes = {name: feature.shape for name, feature in config.image_features.items()}
    shapes |= {STATE: state, MEASURED_STATE: state}
    if config.touch.input == "wrench":
        for slot in config.slots:
            shapes[wrench_key(slot)] = config.touch_shape[1:]
    batch = {name: torch.zeros(1, *shape, device=device) for name, shape in shapes.items()}
    markers = torch.zeros(1, *MARKER_IMAGE_SHAPE, device=device)
    markers[..., ::16, :] = 1.0  # a plain image would hold no markers
    for reference_key, current_key in PAIR_KEYS.values():
        batch[reference_key] = markers
        batch[current_key] = markers
    tokens = torch.zeros(1, config.tokenizer_max_length, dtype=torch.int64, device=device)
    batch[OBS_LANGUAGE_TOKENS] = tokens
    batch[OBS_LANGUAGE_ATTENTION_MASK] = torch.ones_like(tokens, dtype=torch.bool)
    return batch
