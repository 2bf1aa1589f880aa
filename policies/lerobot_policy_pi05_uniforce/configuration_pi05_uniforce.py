"""Settings of ``pi05_uniforce``: LeRobot's π0.5, and groups for touch, actions and sampler."""

import copy
from dataclasses import dataclass, field
from functools import reduce
from operator import attrgetter
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.policies.pi05.configuration_pi05 import PI05Config

from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import SLOTS, STATE, TACTILE_KEYS

# take the size's value (DEFAULTS_BY_SIZE); never left after __post_init__
SIZE_DEFAULT: Any = None

SIZES = ("tiny", "base")
GRID = 4  # latents are pooled to 4×4: 16 tokens per slot
TWO_SLOT_DROPOUT = 0.3  # a policy of two fingers must also do with one
# setting → default of each of SIZES. base: LeRobot's own π0.5 values, which fit the published
# weights; augmentation not tried
DEFAULTS_BY_SIZE: dict[str, tuple[Any, Any]] = {
    "chunk_size": (16, 50),
    "n_action_steps": (2, 50),
    "image_resolution": ((56, 56), (224, 224)),  # tiny: 16 patches of 14² per camera
    "max_action_dim": (8, 32),
    "max_state_dim": (8, 32),
    "tokenizer_max_length": (64, 200),
    "optimizer_lr": (1e-3, 2.5e-5),
    "scheduler_warmup_steps": (3_000, 1_000),
    "scheduler_decay_steps": (100_000, 30_000),
    "scheduler_decay_lr": (1e-5, 2.5e-6),
    "touch.start_at_base": (False, True),  # from scratch there is no base
    "action.form": ("target_delta", "absolute"),
    "action.objective": ("regression", "flow"),
    # tiny: a newton of press or grip is a fraction of a millimetre, not learnt without a knee
    "action.delta_knee": ([0.0, 0.0, 0.001, 0.0, 0.0003], []),
    # tiny: else lights are learnt by heart, docs/experiments/tiny_policy.md
    "augment.camera_variation": (1.0, 0.0),
    "sampler.noise_scale": (0.0, 1.0),
}
# of older checkpoints: what they were tried with didn't pay, and the only value that still runs
REMOVED = {"touch.site": "prefix", "action.previous_steps": 0}
# run-time settings; checkpoints always store these defaults
NEVER_STORED = {
    "grip": "",  # removed, and still named by older checkpoints
    "verify": "full",
    "monitor": "stop",
    "left_calibration": "",
    "right_calibration": "",
}
FORMERLY = {"true": "always", "false": "robot"}  # action.stop_outside_demos
# touch inputs that are no latent map: N, N, N, Nmm that become 1 in the network, so that shear,
# press and torsion of a firm wipe are about 1 there
FORCES: dict[str, tuple[float, ...]] = {
    "newtons": (5, 5, 10),
    "wrench": (5, 5, 10, 100),
}
ENCODED = ("latent", "newtons")  # touch inputs that come from the frozen tokenizer
CHOICES = {
    "verify": ("full", "quick", "off"),
    "monitor": ("stop", "off"),
    "touch.input": (*ENCODED, "wrench", "none"),
    "touch.on_sensor_loss": ("error", "mask"),
    "action.form": ("target_delta", "absolute"),
    "action.objective": ("flow", "regression"),
    "action.stop_outside_demos": ("robot", "always", "never"),
    "sampler.kind": ("fast", "eager", "stock"),
}

# Settings of π0.5 in LeRobot's main that our samplers don't serve → the value that is off
NOT_SERVED = {
    "use_visual_memory": False,
    "use_proprioceptive_memory": False,
    "rtc_training_max_delay": 0,
}


@dataclass
class TouchSettings:
    """Which fingers give force tokens, of what, and where they enter the network."""

    # slot → finger; {} = none
    slots: dict[str, str] = field(default_factory=lambda: {"touch0": "right", "touch1": "left"})
    # "latent": the whole map, as in the paper | "newtons": three numbers that a frozen force head
    # reads in it, which wiped less cleanly (docs/experiments/swap.md) | "none": plain π0.5 |
    # "wrench": the simulator's
    input: str = "latent"
    # input=newtons: sensor type whose force head reads, that of the demonstrations' finger: the
    # shipped one, or the one beside tokenizer_path
    head: str = "tactip"
    site: str = field(default="prefix", init=False)  # REMOVED: older checkpoints name it
    # True: training starts with the base policy's actions, touch behind a learnt gate
    # (touch/tokens.py). tiny: off
    start_at_base: bool = SIZE_DEFAULT
    head_hash: str = ""  # of that head; filled when the policy is made
    # sizes of that head where the tokenizer isn't shipped: the checkpoint then holds its weights
    head_sizes: dict[str, Any] | None = None
    # "error": hold and stop | "mask": go on without that slot, logged; simulation only
    on_sensor_loss: str = "error"
    # slot → sensor types seen in training, "gelsight+uskin"; "" or absent = any
    trained_sensors: dict[str, str] = field(default_factory=dict)
    # REMOVED: older checkpoints name it
    carried_N: dict[str, float] = field(default_factory=dict, init=False)
    # tactile tokenizer to freeze into a new policy; None = the shipped one
    tokenizer_path: str | None = None
    # version of the marker images it was trained on; filled when the policy is made
    marker_images: int = 1
    # its sizes, canonicalizer and content hash; filled when the policy is made
    tokenizer: dict[str, Any] | None = None


@dataclass
class ActionSettings:
    """The network's output: its form, its units and its bounds (action.py)."""

    form: str = SIZE_DEFAULT  # "target_delta" (tiny) | "absolute" (base)
    # "flow": matching, as π0.5 | "regression" (tiny): its last step alone, from zero noise
    objective: str = SIZE_DEFAULT
    # m, m, m, rad, m: about the RMS change of the expert's target over half a chunk
    delta_scale: list[float] = field(default_factory=lambda: [0.004, 0.02, 0.01, 0.05, 0.003])
    # the same units: beyond it a move is predicted by its logarithm, so that corrections of force
    # weigh beside whole moves (tiny: z and width); 0 = linear, [] = all axes
    delta_knee: list[float] = SIZE_DEFAULT
    # target_delta: the demos' lowest and highest target per axis; targets stay within. Found in the
    # data; [] = unknown
    target_range: list[list[float]] = field(default_factory=list)
    # REMOVED: older checkpoints name them
    previous_steps: int = field(default=0, init=False)
    previous_axes: list[int] = field(default_factory=list, init=False)
    # target_delta: m, m, m, rad, m by which an issued target may lead the measured pose. Just above
    # the arm's clip of 18 mm, beyond which no force grows
    leash: list[float] = field(default_factory=lambda: [0.02, 0.02, 0.02, 0.2, 0.03])
    # An action far outside the demos' range ends the rollout with an error. "robot": in LeRobot's
    # rollout on one | "always": in a scene too | "never". NaN always stops. Older checkpoints say
    # true, which is "always", or false, which is "robot"
    stop_outside_demos: str = "robot"


@dataclass
class AugmentSettings:
    """Random changes of every training sample; none at rollout."""

    # lights and camera poses (augment.py); 0 = none, 1 = about as scenes of level touch differ
    camera_variation: float = SIZE_DEFAULT
    touch_dropout: float = SIZE_DEFAULT  # chance to hide a slot; .3 with two slots, 0 with one


@dataclass
class TinySettings:
    """Sizes of ``size=tiny``; VLM and action expert alike."""

    width: int = 128  # of a multiple of 8 heads; 0.5 s per step of batch 32 on one core
    depth: int = 4  # layers; SigLIP has half as many
    mlp_dim: int = 256  # hidden units of each layer's gated MLP


@dataclass
class SamplerSettings:
    """How a chunk is sampled."""

    # "fast": sampler/fast.py, on cuda compiled and from CUDA graphs | "eager": the same without |
    # "stock": LeRobot's
    kind: str = "fast"
    # of the flow's starting noise; tiny 0 (the central action), base 1
    noise_scale: float = SIZE_DEFAULT


@PreTrainedConfig.register_subclass("pi05_uniforce")
@dataclass
class PI05UniforceConfig(PI05Config):
    """π0.5 with force tokens. A field left out takes its size's default (``DEFAULTS_BY_SIZE``).

    Raises ContractError: an unknown choice, slot or finger, or settings that don't go together.
    """

    # "tiny" (CPU, from scratch) | "base" (real π0.5) | "auto": base where CUDA is
    size: str = "auto"
    swap: str = ""  # "touch0:left" lets another finger fill a slot at rollout; weights don't change
    left_sensor: str = ""  # type mounted on the left finger; provenance, "" = not stated
    right_sensor: str = ""  # type mounted on the right finger
    # folder of `uniforce calibrate`, for a new sensor on that finger at rollout; never stored
    left_calibration: str = ""
    right_calibration: str = ""
    # folder or hub name; None: packaged (tiny), PaliGemma's (base)
    text_tokenizer_name: str | None = None
    # repo_id, episodes, frames, fps of the training data: provenance, for the model card
    trained_on: dict[str, str] = field(default_factory=dict)
    # loading: files are compared with hashes.json. "full": all, a second per GB | "quick": from
    # 16 MB by size alone | "off". No checkpoint may ask for its own files not to be compared
    verify: str = "full"
    # rollout: "stop" when a sensor looks unhealthy (tokenizer/latent_range.py) | "off"
    monitor: str = "stop"
    grip: str = field(default="", init=False)  # removed, see NEVER_STORED

    touch: TouchSettings = field(default_factory=TouchSettings)
    action: ActionSettings = field(default_factory=ActionSettings)
    augment: AugmentSettings = field(default_factory=AugmentSettings)
    tiny: TinySettings = field(default_factory=TinySettings)
    sampler: SamplerSettings = field(default_factory=SamplerSettings)

    # π0.5's own, with defaults by size
    chunk_size: int = SIZE_DEFAULT  # [steps] tiny 16: a 1.7 s chunk can't react to touch; base 50
    n_action_steps: int = SIZE_DEFAULT  # [steps] tiny 2 (67 ms at 30 Hz); base 50
    # [px] tiny 56² = 16 patches of 14² per camera; base 224²
    image_resolution: tuple[int, int] = SIZE_DEFAULT
    max_action_dim: int = SIZE_DEFAULT  # tiny 8 (5 axes, padded); base 32, as the published weights
    max_state_dim: int = SIZE_DEFAULT  # tiny 8; base 32
    # [text tokens] tiny 64 (a usual prompt is 20–40); base 200
    tokenizer_max_length: int = SIZE_DEFAULT
    # tiny 1e-3 (from scratch); base 2.5e-5 (openpi's fine-tuning peak)
    optimizer_lr: float = SIZE_DEFAULT
    # tiny: 0.03 of the decay; scaled with it when a run is shorter
    scheduler_warmup_steps: int = SIZE_DEFAULT
    scheduler_decay_steps: int = SIZE_DEFAULT  # tiny 100 000: any shorter run gets its whole cosine
    scheduler_decay_lr: float = SIZE_DEFAULT  # tiny 1e-5; base 2.5e-6

    def __post_init__(self) -> None:
        if self.size == "auto":
            self.size = "tiny"  # 4 B weights don't fit a laptop
            on_cuda = self.device is None or self.device.startswith("cuda")
            if on_cuda and torch.cuda.is_available():
                self.size = "base"
        if self.size not in SIZES:
            wanted = "tiny | base | auto"
            raise ContractError(expected("size", wanted, repr(self.size), "Fix policy.size."))
        for slot in self.touch.slots:
            _require(slot in SLOTS, "touch slot", " or ".join(SLOTS), slot)
        self.finger_by_slot()
        self._fill_in()
        stop = str(self.action.stop_outside_demos)
        self.action.stop_outside_demos = FORMERLY.get(stop.lower(), stop)
        # lists come from JSON
        self.image_resolution = (self.image_resolution[0], self.image_resolution[1])
        for path, known in CHOICES.items():
            came = attrgetter(path)(self)
            _require(came in known, path, " | ".join(known), came)
        self._check_together()
        if self.action.objective == "regression":
            self.num_inference_steps = 1
            self.sampler.noise_scale = 0.0
        # the policy itself turns deltas into targets in SI units
        if self.action.form == "target_delta":
            mapping = vars(self)["normalization_mapping"]
            self.normalization_mapping = {**mapping, "ACTION": NormalizationMode.IDENTITY}
        super().__post_init__()

    def _fill_in(self) -> None:
        """Give every setting that was left out its size's default."""
        defaults: dict[str, Any] = {"augment.touch_dropout": 0.0}
        for path, values in DEFAULTS_BY_SIZE.items():
            defaults[path] = values[SIZES.index(self.size)]
        if len(self.slots) > 1:
            defaults["augment.touch_dropout"] = TWO_SLOT_DROPOUT
        for path, value in defaults.items():
            *group, name = path.split(".")
            owner = reduce(getattr, group, self)
            if getattr(owner, name) is None:
                setattr(owner, name, copy.deepcopy(value))

    def _check_together(self) -> None:
        for name, off in NOT_SERVED.items():
            came = getattr(self, name, off)  # LeRobot 0.6 doesn't have them
            _require(came == off, name, f"{off}: this policy's samplers don't serve it", came)
        touch = self.touch
        stock = self.compile_model or self.gradient_checkpointing or self.dtype != "float32"
        _require(self.size != "tiny" or not stock, "size=tiny", "plain float32", self.dtype)
        square = self.image_resolution[0] == self.image_resolution[1]
        _require(square, "image_resolution", "a square", self.image_resolution)
        calibrated = self.left_calibration or self.right_calibration
        came = f"touch.input={touch.input} in {sorted(touch.slots)}"
        fits = self.encodes or not calibrated
        _require(fits, "left_calibration, right_calibration", "latents to map", came)
        variation = self.augment.camera_variation
        _require(variation >= 0, "augment.camera_variation", "≥ 0", variation)

    def _save_pretrained(self, save_directory: Path) -> None:
        """Write ``config.json``."""
        stored = copy.copy(self)
        stored.__dict__.update(NEVER_STORED)
        PI05Config._save_pretrained(stored, save_directory)

    @property
    def slots(self) -> tuple[str, ...]:
        """Touch slots that give tokens, in a fixed order; empty when touch is off."""
        if self.touch.input == "none":
            return ()
        return tuple(slot for slot in SLOTS if slot in self.touch.slots)

    @property
    def encodes(self) -> bool:
        """Whether touch comes from the frozen tokenizer."""
        return bool(self.slots) and self.touch.input in ENCODED

    @property
    def reads_newtons(self) -> bool:
        """Whether a frozen force head reads newtons in the latents."""
        return bool(self.slots) and self.touch.input == "newtons"

    @property
    def touch_in_view(self) -> str:
        """Input that a training view caches: a policy reads newtons in its latents."""
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
    def state_size(self) -> int:
        """Number of state axes."""
        return self.input_features[STATE].shape[0]

    @property
    def state_token(self) -> bool:
        """Whether the continuous state is a token: 5×256 text bins need more than tiny's demos."""
        return self.size == "tiny"

    @property
    def whole_map(self) -> bool:
        """Whether a force token also holds the slot's whole latent map; not tried at size base."""
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
        """L: numbers per latent of the tokenizer the policy was made with."""
        facts = self.touch.tokenizer
        _require(facts is not None, "touch.tokenizer", "its facts", None)
        return int((facts or {})["model"]["latent"])

    @property
    def touch_shape(self) -> tuple[int, int]:
        """(rows, numbers) of a slot's input: a latent map (K, L), or one row of a force."""
        if self.touch.input == "latent":
            return self.tokens_per_slot, self.latent_size
        return 1, len(FORCES[self.touch.input])

    @property
    def tokenizer_hash(self) -> str:
        """Content hash of the tactile tokenizer; "" without one."""
        return str((self.touch.tokenizer or {}).get("hash", ""))

    @property
    def image_features(self) -> dict[str, Any]:
        """Scene cameras only: marker images must never reach SigLIP."""
        return {k: v for k, v in super().image_features.items() if k not in TACTILE_KEYS}

    @property
    def action_delta_indices(self) -> list[int]:
        """Frames of the action to load: the chunk, for target deltas behind the last command."""
        first = -1 if self.action.form == "target_delta" else 0
        return list(range(first, self.chunk_size))


def _require(fits: bool, name: str, wanted: str, came: object) -> None:
    if not fits:
        raise ContractError(expected(name, wanted, repr(came), "Fix the setting."))
