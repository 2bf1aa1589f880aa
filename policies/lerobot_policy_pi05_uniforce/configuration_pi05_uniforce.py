"""Settings of ``pi05_uniforce``: LeRobot's π0.5 plus touch slots, sizes, action form and provenance."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import CosineDecayWithWarmupSchedulerConfig
from lerobot.policies.pi05.configuration_pi05 import PI05Config

from lerobot_policy_pi05_uniforce.sizes import resolve_size, size_defaults
from uniforce_vtla.contracts import FINGERS, Finger, check_finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import SLOTS, TACTILE_KEYS
from uniforce_vtla.tokenizer.agreed_directions import MOST

_BY_SIZE: Any = None  # "take the size's default"; never left after __post_init__

TWO_SLOT_DROPOUT = 0.3  # DESIGN §8: V+T+G also rolls out with a finger less
CHOICES = {
    "size": ("tiny", "base"),
    "touch_input": ("latent", "wrench", "descriptor", "marker_pair", "none"),
    "action_form": ("target_delta", "absolute"),
    "action_objective": ("flow", "regression"),
    "sampler": ("fast", "stock"),
    "token_site": ("prefix", "suffix"),
    "on_sensor_loss": ("error", "mask"),
    "verify": ("full", "quick", "off"),
}


@PreTrainedConfig.register_subclass("pi05_uniforce")
@dataclass
class PI05UniforceConfig(PI05Config):
    """π0.5 with force tokens.  A field left out takes its size's default (see ``sizes.py``).

    Raises:
        ContractError: an unknown choice, slot, finger or token site.
    """

    size: str = "auto"  # "tiny" (CPU, from scratch) | "base" (real π0.5) | "auto": base where CUDA is

    # Shapes that follow the size
    chunk_size: int = _BY_SIZE  # [steps] tiny 16: a 1.7 s chunk can't react to touch; base 50
    n_action_steps: int = _BY_SIZE  # [steps] tiny 6 (0.2 s at 30 Hz); base 50
    image_resolution: tuple[int, int] = _BY_SIZE  # [px] tiny 56² = 16 patches of 14² per camera; base 224²
    max_action_dim: int = _BY_SIZE  # tiny 8 (5 axes, padded); base 32, as the published weights
    max_state_dim: int = _BY_SIZE  # tiny 8; base 32
    tokenizer_max_length: int = _BY_SIZE  # [text tokens] tiny 64 (a usual prompt is 20–40); base 200
    state_token: bool = (
        _BY_SIZE  # continuous state as a token: 5×256 text bins need more than 50 demos. tiny on
    )
    tiny_width: int = 128  # VLM and expert width: 0.5 s per step of batch 32 on one core
    tiny_depth: int = 4  # layers, both streams
    tiny_head_dim: int = 16  # 8 heads are fixed by LeRobot's joint layer
    tiny_mlp_dim: int = 256  # hidden units of each layer's gated MLP
    tiny_vision_depth: int = 2  # SigLIP layers
    text_tokenizer_name: str | None = None  # folder or hub name; None: packaged (tiny), PaliGemma's (base)

    # training only: lights and camera poses drawn anew per sample (camera_variation.py); 0 = none, 1 = about as much as
    # scenes of level paper differ; tiny 1, base 0
    camera_variation: float = _BY_SIZE

    # Touch
    # slot → finger; {} = none
    touch_slots: dict[str, str] = field(default_factory=lambda: {"touch0": "right"})
    # "latent" | "none" (plain π0.5); controls: "wrench" (true wrench) | "descriptor" (hand-made) | "marker_pair" (CNN)
    touch_input: str = "latent"
    swap: str = ""  # "touch0:left" lets another finger fill a slot at rollout; weights don't change
    left_sensor: str = ""  # kind mounted on the left finger; provenance, "" = not stated
    right_sensor: str = ""  # kind mounted on the right finger
    # slot → kinds seen in training, "gelsight+uskin"; "" or absent = any
    trained_sensors: dict[str, str] = field(default_factory=dict)
    # repo_id, episodes, frames, fps of the training data: provenance, for the model card
    trained_on: dict[str, str] = field(default_factory=dict)
    latent_grid: int = 4  # latents pooled to 4×4, so K = 16 tokens per slot
    # "prefix": beside cameras and text, encoded once | "suffix": before the actions, read in every flow step
    token_site: str = "prefix"
    # True: training starts at the base policy exactly, touch behind a gate that is learnt (touch_gate.py). tiny off
    start_at_base: bool = _BY_SIZE
    # each force token also holds what is made of its slot's whole map (force_tokens.py); tiny on, base not tried
    hear_whole_pad: bool = _BY_SIZE
    # hear latents only along so many directions on which all sensors agree (agreed_directions.py); 0 = the whole map
    touch_directions: int = 0
    force_token_scale: float = 1.0  # initial RMS of a force token; patches of a new tiny model come in at 0.3
    touch_dropout: float | None = (
        None  # chance to hide a slot for a sample; None: .3 with two slots, 0 with one
    )
    # training only: Gaussian noise on latents, in units of each channel's spread; tiny 0.2, base 0. With
    # touch_directions in units of what fingers of one grasp disagree along each: 1 hears as if another finger told it
    touch_noise: float = _BY_SIZE
    # training only: share of samples whose latents are told as another sensor would (transferred_touch.py); needs slots
    # whose demos are of one kind each
    sensor_transfer: float = 0.0
    # how much of the maps' doubt is drawn then, 0 to 1: whole doubt makes a policy listen less to swapped fingers and
    # reads them no better (docs/experiments/tiny_policy.md)
    sensor_transfer_doubt: float = 0.25
    # training only, with a state token: Gaussian noise on the normalised state, per axis; [] = none
    state_noise: list[float] = field(default_factory=list)
    # with a state token and target_delta: how far the command moved over so many of its last steps is told beside the
    # state, so that who is in mid-stroke knows which way; 0 = not told. As many as n_action_steps, or more
    last_move_steps: int = 0
    # the axes of it that are told, [] = all. Who is told that his fingers stand still learns to leave them so
    last_move_axes: list[int] = field(default_factory=list)
    # training only: noise on it, in units of delta_scale: corrections of force drown in it, strokes and lifts don't
    last_move_noise: float = 0.1
    on_sensor_loss: str = "error"  # "error": hold and stop; "mask": simulation only, logged
    tokenizer_path: str | None = None  # tactile tokenizer to freeze into a new policy; None = the shipped one
    tokenizer_config: dict[str, Any] | None = None  # filled from that tokenizer, rebuilds it on load
    tokenizer_hash: str = ""  # content hash of its weights, config and canonicaliser
    num_patches: int = 0  # P of its latents
    latent_size: int = 6  # numbers per patch

    # Action
    action_form: str = _BY_SIZE  # "target_delta" (tiny) | "absolute" (base); see action_form.py
    # "flow": matching, as π0.5 | "regression": its last step alone, from zero noise, one step to sample (tiny;
    # docs/experiments/tiny_policy.md)
    action_objective: str = _BY_SIZE
    sampling_noise: float = (
        _BY_SIZE  # scale of the flow's starting noise: tiny 0, see docs/experiments; base 1
    )
    sampler: str = "fast"  # "fast": fast_sampler.py, equal within 1e-4 | "stock": LeRobot's own loop
    cuda_graphs: bool = True  # sampler=fast replays CUDA graphs on cuda (cuda_graphs.py; never run on a GPU)
    # m, m, m, rad, m: about the RMS change of the commanded target over half a chunk of the wiping expert
    delta_scale: list[float] = field(default_factory=lambda: [0.004, 0.02, 0.01, 0.05, 0.003])
    # the same units: beyond it the network tells a move by its logarithm, so that corrections of force weigh beside
    # whole moves (action_form.py); 0 = linear, [] = all axes
    delta_knee: list[float] = field(default_factory=list)
    # target_delta: targets stay within what the demos commanded, axis by axis: changes could add up to places nobody
    # has shown, and a hand that rose there went on rising (docs/experiments/tiny_policy.md)
    keep_inside_demos: bool = True
    # the lowest and the highest target of the demos, SI per axis; found in the training data, [] = not known: not kept
    target_range: list[list[float]] = field(default_factory=list)

    normalization_mapping: dict[str, NormalizationMode] = (
        field(  # only state and absolute actions are normalised
            default_factory=lambda: {
                "VISUAL": NormalizationMode.IDENTITY,
                "STATE": NormalizationMode.QUANTILES,
                "ACTION": NormalizationMode.QUANTILES,  # IDENTITY for target_delta, set below
            }
        )
    )

    # True: an action far outside the demos' range stops the rollout with an error (check_action.py). For a robot; in
    # simulation a poor policy should be scored, not end the run. NaN always stops.
    stop_outside_demos: bool = False

    # loading: files are compared with hashes.json. "full": all, a second per GB | "quick": from 16 MB by size
    # alone | "off". A checkpoint always stores "full": none may ask for its own files not to be compared
    verify: str = "full"

    # Training
    optimizer_lr: float = _BY_SIZE  # tiny 1e-3 (from scratch); base 2.5e-5 (openpi's fine-tuning peak)
    new_module_lr: float = _BY_SIZE  # force and state projections start random: tiny as above, base 1e-4
    # weight of an auxiliary loss: what is felt when the next chunk begins (next_force.py); latents from a view only
    next_force_weight: float = 0.0
    touch_gate_lr: float = 1e-3  # of the gate alone: it goes from 1e-6 to the order of 1
    scheduler_warmup_steps: int = _BY_SIZE  # tiny: 0.03 of the decay; scaled with it when a run is shorter
    scheduler_decay_steps: int = _BY_SIZE  # tiny 100 000: any shorter run gets its whole cosine
    scheduler_decay_lr: float = _BY_SIZE  # tiny 1e-5; base 2.5e-6

    def __post_init__(self) -> None:
        self.size = resolve_size(self.size, self.device)
        for name, value in size_defaults(self.size).items():
            if getattr(self, name) is None:
                setattr(self, name, value)
        self.image_resolution = (self.image_resolution[0], self.image_resolution[1])  # lists come from JSON
        self._check()
        if self.action_objective == "regression":
            self.num_inference_steps, self.sampling_noise = 1, 0.0
        if (
            self.action_form == "target_delta"
        ):  # the policy itself turns deltas into absolute targets in SI units
            self.normalization_mapping = {**self.normalization_mapping, "ACTION": NormalizationMode.IDENTITY}
        super().__post_init__()

    def _check(self) -> None:
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                wanted = " | ".join(choices)
                raise ContractError(expected(name, wanted, repr(getattr(self, name)), "Fix the setting."))
        if self.size == "tiny" and (
            self.compile_model or self.gradient_checkpointing or self.dtype != "float32"
        ):
            came = "compile_model, gradient_checkpointing or bfloat16"
            raise ContractError(expected("size=tiny", "plain float32", came, "Leave these to size=base."))
        if self.next_force_weight and (self.touch_input != "latent" or not self.touch_slots):
            came = f"touch_input={self.touch_input} with slots {sorted(self.touch_slots)}"
            raise ContractError(expected("next_force_weight", "latents to predict", came, "Set it to 0."))
        if not 0 <= self.sensor_transfer <= 1 or (self.sensor_transfer and self.touch_input != "latent"):
            came = f"{self.sensor_transfer} with touch_input={self.touch_input}"
            do = "Set it to 0, or feel latents."
            raise ContractError(expected("sensor_transfer", "a share of latents", came, do))
        if not 0 <= self.touch_directions <= MOST or (self.touch_directions and self.touch_input != "latent"):
            came = f"{self.touch_directions} with touch_input={self.touch_input}"
            raise ContractError(expected("touch_directions", f"0 to {MOST} of latents", came, "Set it to 0."))
        if self.last_move_steps < 0 or (
            self.last_move_steps and not (self.state_token and self.action_form == "target_delta")
        ):
            came = f"{self.last_move_steps} with state_token={self.state_token}, {self.action_form}"
            do = "Set it to 0, or tell the state and predict target_delta."
            raise ContractError(expected("last_move_steps", "0, or steps before now", came, do))
        axes = range(len(self.delta_scale))
        if len(set(self.last_move_axes) & set(axes)) < len(self.last_move_axes):
            do = "Name each at most once, or none for all."
            raise ContractError(expected("last_move_axes", f"some of {[*axes]}", self.last_move_axes, do))
        if self.camera_variation < 0:
            do = "0 leaves the pictures as they are."
            raise ContractError(expected("camera_variation", "≥ 0", self.camera_variation, do))
        if not 0 <= self.sensor_transfer_doubt <= 1:
            do = "Take the tested 0.25."
            raise ContractError(expected("sensor_transfer_doubt", "0 to 1", self.sensor_transfer_doubt, do))
        for slot, finger in self.touch_slots.items():
            _check_slot(slot)
            check_finger(finger)
        self.finger_by_slot()

    def _save_pretrained(self, save_directory: Path) -> None:
        """Write ``config.json``."""
        given, self.verify = self.verify, "full"
        try:
            super()._save_pretrained(save_directory)
        finally:
            self.verify = given

    @property
    def slots(self) -> tuple[str, ...]:
        """Touch slots that give tokens, in a fixed order; empty when touch is off."""
        return tuple(s for s in SLOTS if s in self.touch_slots) if self.touch_input != "none" else ()

    def finger_by_slot(self) -> dict[str, Finger]:
        """Which finger fills each slot now, after ``swap``."""
        fingers = {slot: check_finger(finger) for slot, finger in self.touch_slots.items()}
        for entry in filter(None, self.swap.replace(" ", "").split(",")):
            slot, _, finger = entry.partition(":")
            if slot not in fingers:
                raise ContractError(
                    expected(
                        "swap", f"one of the slots {list(fingers)}", repr(entry), "Write swap=touch0:left."
                    )
                )
            fingers[slot] = check_finger(finger)
        return fingers

    @property
    def mounted_sensors(self) -> dict[str, str]:
        """Finger → kind of sensor stated in this config ("" where not stated)."""
        return dict(zip(FINGERS, (self.left_sensor, self.right_sensor), strict=True))

    @property
    def hidden_share(self) -> float:
        """Chance that training hides a slot: one checkpoint then serves with and without it."""
        if self.touch_dropout is not None:
            return self.touch_dropout
        return TWO_SLOT_DROPOUT if len(self.slots) > 1 else 0.0

    @property
    def tokens_per_slot(self) -> int:
        """K: pooled latents per slot."""
        return self.latent_grid**2

    @property
    def told_axes(self) -> list[int]:
        """Axes of the command whose last move is told; none without ``last_move_steps``."""
        every = list(range(len(self.delta_scale)))
        return (self.last_move_axes or every) if self.last_move_steps else []

    @property
    def image_features(self) -> dict[str, Any]:
        """Scene cameras only: marker images must never reach SigLIP."""
        return {k: v for k, v in super().image_features.items() if k not in TACTILE_KEYS}

    @property
    def action_delta_indices(self) -> list[int]:
        """Frames of the action to load: the chunk, for target deltas behind the last command, for its move one before.

        ``prepare_action`` and ``told_move`` know this order.
        """
        chunk = list(range(self.chunk_size))
        if self.action_form != "target_delta":
            return chunk
        return [-1 - self.last_move_steps, -1, *chunk] if self.last_move_steps else [-1, *chunk]

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Warm-up, then one cosine over the run (LeRobot shortens both for shorter runs)."""
        return CosineDecayWithWarmupSchedulerConfig(
            peak_lr=self.optimizer_lr,
            decay_lr=self.scheduler_decay_lr,
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
        )


def _check_slot(slot: str) -> None:
    if slot not in SLOTS:
        raise ContractError(
            expected("touch slot", " or ".join(SLOTS), repr(slot), "Write touch_slots={touch0: right}.")
        )
