"""Settings of ``pi05_uniforce``: LeRobot's π0.5 plus groups for touch, actions, augmentation, sizes and sampler."""

import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.policies.pi05.configuration_pi05 import PI05Config

from lerobot_policy_pi05_uniforce.sizes import GRID, resolve_size, size_settings
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import SLOTS, TACTILE_KEYS

# take the size's value (sizes.py); never left after __post_init__
_BY_SIZE: Any = None

# settings of who loads a checkpoint, not of who wrote it: stored at these values alone
NEVER_STORED = {
    "verify": "full",
    "monitor": "stop",
    "grip": "",
    "left_calibration": "",
    "right_calibration": "",
}
MOST_CARRIED_N = 100.0  # of a grip: no finger reads more
FORMERLY = {"true": "always", "false": "robot"}  # action.stop_outside_demos
ENCODED = ("latent", "newtons")  # touch inputs that come from the frozen tokenizer
CHOICES = {
    "size": ("tiny", "base"),
    "verify": ("full", "quick", "off"),
    "monitor": ("stop", "off"),
    "grip": ("", "read", "held"),
    "touch.input": ("latent", "newtons", "wrench", "none"),
    "touch.site": ("prefix", "suffix"),
    "touch.on_sensor_loss": ("error", "mask"),
    "action.form": ("target_delta", "absolute"),
    "action.objective": ("flow", "regression"),
    "action.stop_outside_demos": ("robot", "always", "never"),
    "sampler.kind": ("fast", "eager", "stock"),
}


@dataclass
class TouchSettings:
    """Which fingers give force tokens, of what, and where they enter the network."""

    # slot → finger; {} = none
    slots: dict[str, str] = field(default_factory=lambda: {"touch0": "right"})
    # "newtons" (tiny): what a frozen force head reads in the latents, three numbers | "latent" (base): the whole map,
    # as in the paper | "none" (plain π0.5); "wrench" (the simulator's
    # true wrench, a ceiling)
    input: str = _BY_SIZE
    # input=newtons: kind whose force head reads, that of the demonstrations' finger: the shipped one, or beside
    # tokenizer_path
    head: str = "tactip"
    # "prefix": beside cameras and text, encoded once | "suffix": before the actions, read in every flow step
    site: str = "prefix"
    # True: training starts with the base policy's actions, touch behind a learnt gate (touch/tokens.py). tiny off
    start_at_base: bool = _BY_SIZE
    head_hash: str = ""  # of that head; filled when the policy is made
    # sizes of that head where the tokenizer isn't shipped: the checkpoint then holds the head's weights
    head_sizes: dict[str, Any] | None = None
    # "error": hold and stop; "mask": go on without that slot, logged; simulation only
    on_sensor_loss: str = "error"
    # slot → kinds seen in training, "gelsight+uskin"; "" or absent = any
    trained_sensors: dict[str, str] = field(default_factory=dict)
    # slot → N of grip that the demonstrations' finger read once lifted (touch/grip.py); filled from a view
    carried_N: dict[str, float] = field(default_factory=dict)
    # tactile tokenizer to freeze into a new policy; None = the shipped one
    tokenizer_path: str | None = None
    # version of the marker images it was trained on; filled when the policy is made
    marker_images: int = 1
    # its sizes, canonicalizer and content hash; filled when the policy is made
    tokenizer: dict[str, Any] | None = None


@dataclass
class ActionSettings:
    """The network's output: its form, its units and its bounds (action.py)."""

    form: str = _BY_SIZE  # "target_delta" (tiny) | "absolute" (base)
    # "flow": matching, as π0.5 | "regression": its last step alone, from zero noise, one step to sample (tiny)
    objective: str = _BY_SIZE
    # m, m, m, rad, m: about the RMS change of the commanded target over half a chunk of the wiping expert
    delta_scale: list[float] = field(default_factory=lambda: [0.004, 0.02, 0.01, 0.05, 0.003])
    # the same units: beyond it a move is predicted by its logarithm, so that corrections of force weigh beside whole
    # moves (tiny: z and width); 0 = linear, [] = all axes
    delta_knee: list[float] = _BY_SIZE
    # target_delta: the demos' lowest and highest target per axis; targets stay within. Found in the data; [] = unknown
    target_range: list[list[float]] = field(default_factory=list)
    # target_delta of tiny: the previous action, as the command's move over so many steps, stands beside the state;
    # 0 = not given. As many as n_action_steps, or more
    previous_steps: int = _BY_SIZE
    previous_axes: list[int] = _BY_SIZE  # its axes; [] = all
    # target_delta: how far each axis of an issued target may lead the measured pose, m, m, m, rad, m; as a
    # teleoperator's. Just above the arm's clip of 18 mm, beyond which no force grows
    leash: list[float] = field(default_factory=lambda: [0.02, 0.02, 0.02, 0.2, 0.03])
    # An action far outside the demos' range ends the rollout with an error. "robot": in LeRobot's rollout on one |
    # "always": in a scene too | "never". NaN always stops. Older checkpoints say true, which is "always", or false,
    # which was never asked for: "robot"
    stop_outside_demos: str = "robot"


@dataclass
class AugmentSettings:
    """Random changes of every training sample; nothing of it runs at rollout."""

    # lights and camera poses (augment.py); 0 = none, 1 = about as much as scenes of level touch differ; base 0
    camera_variation: float = _BY_SIZE
    touch_dropout: float = _BY_SIZE  # chance to hide a slot; .3 with two slots, 0 with one


@dataclass
class TinySettings:
    """Sizes of ``size=tiny``; VLM and action expert alike."""

    width: int = 128  # of a multiple of 8 heads; 0.5 s per step of batch 32 on one core
    depth: int = 4  # layers; SigLIP has half as many
    mlp_dim: int = 256  # hidden units of each layer's gated MLP


@dataclass
class SamplerSettings:
    """How a chunk is sampled."""

    # "fast": sampler/fast.py, with CUDA graphs on cuda | "eager": without them | "stock": LeRobot's own loop
    kind: str = "fast"
    # of the flow's starting noise; tiny 0 (the central action), base 1
    noise_scale: float = _BY_SIZE


@PreTrainedConfig.register_subclass("pi05_uniforce")
@dataclass
class PI05UniforceConfig(PI05Config):
    """π0.5 with force tokens.  A field left out takes its size's default (``sizes.py``).

    Raises ContractError: an unknown choice, slot, finger or token site, or settings that don't go together.
    """

    # "tiny" (CPU, from scratch) | "base" (real π0.5) | "auto": base where CUDA is
    size: str = "auto"
    swap: str = ""  # "touch0:left" lets another finger fill a slot at rollout; weights don't change
    left_sensor: str = ""  # kind mounted on the left finger; provenance, "" = not stated
    right_sensor: str = ""  # kind mounted on the right finger
    # folder of `uniforce calibrate`, for a new sensor on that finger at rollout; never stored with a policy
    left_calibration: str = ""
    right_calibration: str = ""
    # folder or hub name; None: packaged (tiny), PaliGemma's (base)
    text_tokenizer_name: str | None = None
    # repo_id, episodes, frames, fps of the training data: provenance, for the model card
    trained_on: dict[str, str] = field(default_factory=dict)
    # loading: files are compared with hashes.json. "full": all, a second per GB | "quick": from 16 MB by size
    # alone | "off". A checkpoint always stores "full": none may ask for its own files not to be compared
    verify: str = "full"
    # rollout: "stop" when a sensor gives what no healthy one of its kind does (tokenizer/latent_range.py) | "off".
    # A checkpoint always stores "stop"
    monitor: str = "stop"
    # rollout, touch.input=newtons: "read" as the finger reads it | "held", once lifted, at what demonstrations read |
    # "": held where the finger's calibration can't read grip under a tool. Never stored
    grip: str = ""

    touch: TouchSettings = field(default_factory=TouchSettings)
    action: ActionSettings = field(default_factory=ActionSettings)
    augment: AugmentSettings = field(default_factory=AugmentSettings)
    tiny: TinySettings = field(default_factory=TinySettings)
    sampler: SamplerSettings = field(default_factory=SamplerSettings)

    # π0.5's own, with defaults by size
    chunk_size: int = _BY_SIZE  # [steps] tiny 16: a 1.7 s chunk can't react to touch; base 50
    n_action_steps: int = _BY_SIZE  # [steps] tiny 2 (67 ms at 30 Hz); base 50
    # [px] tiny 56² = 16 patches of 14² per camera; base 224²
    image_resolution: tuple[int, int] = _BY_SIZE
    max_action_dim: int = _BY_SIZE  # tiny 8 (5 axes, padded); base 32, as the published weights
    max_state_dim: int = _BY_SIZE  # tiny 8; base 32
    # [text tokens] tiny 64 (a usual prompt is 20–40); base 200
    tokenizer_max_length: int = _BY_SIZE
    # tiny 1e-3 (from scratch); base 2.5e-5 (openpi's fine-tuning peak)
    optimizer_lr: float = _BY_SIZE
    # tiny: 0.03 of the decay; scaled with it when a run is shorter
    scheduler_warmup_steps: int = _BY_SIZE
    scheduler_decay_steps: int = _BY_SIZE  # tiny 100 000: any shorter run gets its whole cosine
    scheduler_decay_lr: float = _BY_SIZE  # tiny 1e-5; base 2.5e-6

    def __post_init__(self) -> None:
        self.size = resolve_size(self.size, self.device)
        for slot in self.touch.slots:
            _require(slot in SLOTS, "touch slot", " or ".join(SLOTS), slot)
        self.finger_by_slot()
        for path, value in size_settings(self.size, self.slots).items():
            owner, name = self._owner(path)
            if getattr(owner, name) is None:
                setattr(owner, name, copy.deepcopy(value))
        stop = str(self.action.stop_outside_demos)
        self.action.stop_outside_demos = FORMERLY.get(stop.lower(), stop)
        # lists come from JSON
        self.image_resolution = (self.image_resolution[0], self.image_resolution[1])
        for path, known in CHOICES.items():
            came = getattr(*self._owner(path))
            _require(came in known, path, " | ".join(known), came)
        self._check_together()
        if self.action.objective == "regression":
            self.num_inference_steps, self.sampler.noise_scale = 1, 0.0
        # the policy itself turns deltas into targets in SI units
        if self.action.form == "target_delta":
            mapping = vars(self)["normalization_mapping"]
            self.normalization_mapping = {**mapping, "ACTION": NormalizationMode.IDENTITY}
        super().__post_init__()

    def _owner(self, path: str) -> tuple[Any, str]:
        group, _, name = path.rpartition(".")
        return (getattr(self, group) if group else self), name

    def _check_together(self) -> None:
        touch, action, augment = self.touch, self.action, self.augment
        stock = self.compile_model or self.gradient_checkpointing or self.dtype != "float32"
        _require(self.size != "tiny" or not stock, "size=tiny", "plain float32", self.dtype)
        square = self.image_resolution[0] == self.image_resolution[1]
        _require(square, "image_resolution", "a square", self.image_resolution)
        mapped = touch.input in ENCODED and bool(touch.slots)
        came = f"touch.input={touch.input} in {sorted(touch.slots)}"
        feels = touch.input == "newtons" and bool(touch.slots)
        _require(
            feels or self.grip != "held", "grip", "read: this policy feels no newtons", self.grip
        )
        for slot, held_N in touch.carried_N.items():
            fits = isinstance(held_N, int | float) and 0 < held_N < MOST_CARRIED_N
            _require(fits, f"touch.carried_N of {slot}", f"0 to {MOST_CARRIED_N} N", held_N)
        fit = mapped or not (self.left_calibration or self.right_calibration)
        _require(fit, "left_calibration, right_calibration", "latents to map", came)
        deltas = self.state_token and action.form == "target_delta"
        _require(
            augment.camera_variation >= 0,
            "augment.camera_variation",
            "≥ 0",
            augment.camera_variation,
        )
        steps, axes = action.previous_steps, action.previous_axes
        fit = steps >= 0 and (deltas or not steps)
        _require(fit, "action.previous_steps", "0, or more with tiny's deltas", steps)
        fit = len(set(axes) & set(range(len(action.delta_scale)))) == len(axes)
        _require(fit, "action.previous_axes", "axes, each at most once", axes)

    def _save_pretrained(self, save_directory: Path) -> None:
        """Write ``config.json``."""
        given = {name: getattr(self, name) for name in NEVER_STORED}
        self._set(NEVER_STORED)
        try:
            super()._save_pretrained(save_directory)
        finally:
            self._set(given)

    def _set(self, values: dict[str, Any]) -> None:
        for name, value in values.items():
            setattr(self, name, value)

    @property
    def slots(self) -> tuple[str, ...]:
        """Touch slots that give tokens, in a fixed order; empty when touch is off."""
        return (
            tuple(s for s in SLOTS if s in self.touch.slots) if self.touch.input != "none" else ()
        )

    @property
    def touch_in_view(self) -> str:
        """Input that a training view caches for this policy: "newtons" are read in latents by its own head."""
        return "latent" if self.touch.input in ENCODED else self.touch.input

    def finger_by_slot(self) -> dict[str, Finger]:
        """Which finger fills each slot now, after ``swap``."""
        fingers: dict[str, Any] = dict(self.touch.slots)
        for entry in filter(None, self.swap.replace(" ", "").split(",")):
            slot, _, fingers[slot] = entry.partition(":")
            wanted = f"one of {list(self.touch.slots)}, as in touch0:left"
            _require(slot in self.touch.slots, "swap", wanted, entry)
        for slot, finger in fingers.items():
            _require(finger in FINGERS, f"finger of {slot}", " | ".join(FINGERS), finger)
        return fingers

    @property
    def state_token(self) -> bool:
        """Whether the continuous state is a token: 5×256 text bins need more than tiny's demos."""
        return self.size == "tiny"

    @property
    def whole_map(self) -> bool:
        """Whether a force token also holds what is made of its slot's whole latent map; not tried at size base."""
        return self.size == "tiny" and self.touch.input == "latent"

    @property
    def latent_grid(self) -> int:
        """Side of the grid that latents are pooled to; a view's must be the same."""
        return GRID

    @property
    def tokens_per_slot(self) -> int:
        """K: pooled latents per slot."""
        return GRID**2

    @property
    def latent_size(self) -> int:
        """Numbers per latent of the tokenizer the policy was made with."""
        _require(self.touch.tokenizer is not None, "touch.tokenizer", "its facts", None)
        return int((self.touch.tokenizer or {})["model"]["latent"])

    @property
    def tokenizer_hash(self) -> str:
        """Content hash of the tactile tokenizer; "" without one."""
        return str((self.touch.tokenizer or {}).get("hash", ""))

    @property
    def previous_axes(self) -> list[int]:
        """Axes of the previous action beside the state; none without ``action.previous_steps``."""
        every = list(range(len(self.action.delta_scale)))
        return (self.action.previous_axes or every) if self.action.previous_steps else []

    @property
    def image_features(self) -> dict[str, Any]:
        """Scene cameras only: marker images must never reach SigLIP."""
        return {k: v for k, v in super().image_features.items() if k not in TACTILE_KEYS}

    @property
    def action_delta_indices(self) -> list[int]:
        """Frames of the action to load: the chunk; for target deltas behind the last command, and the one it came from.

        ``prepare_action`` and ``previous_move`` know this order.
        """
        chunk, steps = list(range(self.chunk_size)), self.action.previous_steps
        if self.action.form != "target_delta":
            return chunk
        return [-1 - steps, -1, *chunk] if steps else [-1, *chunk]


def _require(fits: bool, name: str, wanted: str, came: object) -> None:
    if not fits:
        raise ContractError(expected(name, wanted, repr(came), "Fix the setting."))
