"""Settings of the tokenizer, its pretraining and its calibration; importing them takes no torch."""

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import (
    Count,
    CountOrZero,
    FolderPath,
    NotNegative,
    Pixels,
    Positive,
    Rate,
    Seed,
    Share,
    TokenizerFolder,
)

LATER = ("warp",)  # fields of TokenizerConfig that came after the first shipped checkpoint
LIMITS = {  # of TokenizerConfig: far beyond what is ever trained, far below what fills a machine
    "side": (1, 2048),
    "patch": (1, 2048),
    "width": (1, 8192),
    "depth": (1, 64),
    "decoder_depth": (1, 64),
    "heads": (1, 128),
    "mlp_ratio": (1, 16),
    "embed_hidden": (0, 16384),
    "motion_scales": (0, 8),
    "latent": (1, 256),
}
MAX_PATCHES = 4096  # 64×64
# objects of a calibration, half and half: one class alone fails on the other (docs/design.md)
OBJECT_CLASSES = ("small", "tool")


@dataclass(frozen=True)
class TokenizerConfig:
    """Sizes of the model; all of them travel with the checkpoint."""

    # pixels per side of the square it sees; a fifth of 640, so areas average exactly
    side: int = 128
    patch: int = 16  # pixels per side of a patch; P = (side / patch)²
    width: int = 128  # D, size of a token
    depth: int = 2  # encoder blocks
    decoder_depth: int = 1  # decoder blocks
    heads: int = 4  # attention heads; width must divide by it
    mlp_ratio: int = 3  # hidden size of a block's MLP over width
    # hidden units inside the encoder's patch embedding; 0 = linear, as in the paper
    embed_hidden: int = 256
    # scales of motion channels given to current tokens; 0 = none, as in the paper
    motion_scales: int = 3
    latent: int = 6  # numbers per patch (paper)
    predict_change: bool = True  # decoder adds to the reference instead of redrawing every marker
    # decoder also moves the reference's pixels along a flow it predicts; a marker stays a marker
    warp: bool = False

    def __post_init__(self) -> None:
        for name, (least, most) in LIMITS.items():
            check_count(f"tokenizer's {name}", getattr(self, name), most, least)
        check_count("tokenizer's patches", self.num_patches, MAX_PATCHES)
        if self.side % self.patch or self.width % self.heads or self.width % 4:
            came = f"side {self.side}, patch {self.patch}, width {self.width}, heads {self.heads}"
            wanted = "patch | side, heads | width, 4 | width"
            raise ContractError(expected("tokenizer sizes", wanted, came, "Change one."))

    def facts(self) -> dict[str, Any]:
        """Return all sizes by name; later options only where they are on, to keep older hashes."""
        return {name: value for name, value in asdict(self).items() if name not in LATER or value}

    @property
    def grid(self) -> int:
        """Patches per side."""
        return self.side // self.patch

    @property
    def num_patches(self) -> int:
        """P."""
        return self.grid**2


@dataclass(frozen=True)
class LossConfig:
    """Weights and named variants of the objective."""

    perceptual_weight: NotNegative = 0.1  # λ of the perceptual term, a pyramid of image gradients
    kl_weight: NotNegative = 1e-2  # λ of the KL term, per latent number
    equilibrium_weight: NotNegative = 4.0  # λ of the equilibrium term
    # it rises linearly: at full weight from the start, z learns to be 0
    equilibrium_warmup_steps: CountOrZero = 300
    # patch is the paper's; levels adds 4×4 regions and the total, where real forces balance better
    equilibrium: Literal["patch", "levels"] = "patch"
    # absolute is the paper's; per_unit divides each sensor's latents by their RMS,
    # so that a less sensitive sensor isn't counted as imbalance
    equilibrium_scale: Literal["absolute", "per_unit"] = "absolute"
    # extra weight where current differs from reference; 0 = plain L1
    changed_pixel_weight: NotNegative = 10.0
    pyramid_levels: Count = 3  # scales of the gradient pyramid
    # errors are summed over a patch, as in the equilibrium term; with a mean over pixels
    # the latent collapses (docs/experiments/tokenizer.md)
    pixels_per_patch: Count = 256


@dataclass(frozen=True)
class PairCacheConfig:
    """How much is drawn; everything that decides the cache's content."""

    side: Pixels = 128  # pixels, the model's
    units: Count = 768  # units per rig; each has its own layout, view, stiffness and gains
    pairs_per_unit: Count = 16  # contacts of one unit: they share a reference
    # one file per so many units; a killed run continues at the next shard
    units_per_shard: Count = 64
    seed: Seed = 1  # of everything drawn
    # share of cameras drawn from the procedural family; 0 = the paper's three sensors
    family_share: Share = 0.0
    free_look: bool = False  # every camera with a pose, zoom and marker size of its own
    marker_loss: Share = 0.0  # chance per marker and frame, in half of the units
    # fingers up to so many cells of 1.25 mm off each other; 0 = they face
    misaligned_cells: CountOrZero = 0
    # the right finger's force is off by up to this share; 0 = perfect equilibrium
    imbalance: Share = 0.0
    flat_share: Share = 0.15  # flat faces, the side of a held tool, among the indenters
    # sensor type held out of pretraining with its family, to test transfer to an unseen type
    left_out: Literal["", "gelsight", "uskin"] = ""
    # [mm] torsion over friction × normal force of flat faces; wiping with a held tool reaches 9
    flat_torsion_arm_mm: NotNegative = 2.5


@dataclass(frozen=True)
class PretrainSettings:
    """Everything a pretraining run depends on."""

    model: TokenizerConfig = field(default_factory=TokenizerConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    data: PairCacheConfig = field(default_factory=PairCacheConfig)
    # recorded by `uniforce pairs`, its uniforce_pairs/; "" = drawn as data says
    pairs: FolderPath = ""
    steps: Count = 2600  # optimiser steps
    units_per_batch: Count = 4  # units (references) in a batch
    pairs_per_unit: Count = 8  # contacts of each: 4 × 8 = 32 pairs
    learning_rate: Rate = 1e-3  # peak, AdamW
    weight_decay: NotNegative = 0.01  # AdamW
    warmup_steps: CountOrZero = 100  # linear to the peak, then cosine to a fiftieth
    clip_norm: Positive = 1.0  # of the gradient
    seed: Seed = 0  # weights, batches, latent noise
    save_every: Count = 100  # steps between checkpoints a killed run continues from
    # tokenizer folder whose weights it starts from; empty = drawn from the seed
    init: TokenizerFolder = ""
    # accelerate's; float32 is fastest on most CPUs
    mixed_precision: Literal["no", "bf16", "fp16"] = "no"
    strips_every: CountOrZero = 500  # steps between pictures of reconstructions (strips/); 0 = none


@dataclass(frozen=True)
class CalibrationConfig:
    """How a calibration is chosen, fitted and judged."""

    held_out: Share = 0.2  # share of the grasps that only judge
    min_pairs: Count = 50  # half of them of each class; fewer say nothing about whole maps
    seed: Seed = 0  # which grasps judge
    # R² of Fz on held-out grasps of the task's class; less is no calibration
    refuse_below: Share = 0.5
    warn_below: Share = 0.8  # less is worth another try
