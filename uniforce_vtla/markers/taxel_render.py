"""Taxel counts → canonical marker image: a white disc per taxel, moved by shear, grown by pressure.

A uSkin's picture is the one the GenForce collection rig draws: taxel i rests at column i mod 4, row
i div 4 *from the bottom*. Shear counts move the disc, normal counts grow its area. Another layout
is drawn at its own places: as many pixels per shear count, and areas in proportion to a taxel's
cell, so that equal pressure paints as much white however many taxels feel it.
"""

import math
from dataclasses import asdict, dataclass

import cv2
import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, TAXEL_SHAPE
from uniforce_vtla.errors import ContractError, SensorError, described, expected
from uniforce_vtla.markers.raster import CENTRE_PX
from uniforce_vtla.sensors import SensorSpec

SUBPIXEL_BITS = 4  # cv2 takes fixed-point centres; 1/16 px is far below a pixel

# either way: a uSkin's registers hold 16 bits, and taring makes some negative
MOST_COUNTS = 1 << 17
CELL_PX = np.array([128.0, 96.0])  # of a uSkin: columns and rows between neighbours
# cv2 fills the pixels its outline touches: this much less gives the disc's true area
EDGE_PX = 0.45


@dataclass(frozen=True)
class TaxelScales:
    """How counts become geometry, stored and hashed by checkpoints: change ``version`` with it."""

    version: str = "uskin-collection-1"
    counts_per_pitch: float = 2000.0  # S: shear counts that move a disc by one pitch of a uSkin
    area_rest_pt2: float = 100.0  # matplotlib "points²" at rest: 13.9 px across
    area_per_count_pt2: float = 1.0  # k: growth of the area per normal count
    area_max_pt2: float = 6000.0  # 107.6 px across; beyond it the disc saturates
    shift_max_pitch: float = 0.8  # shear beyond this is clipped, so that taxels don't change places
    # a disc's centre stays this far from the outermost taxels, still on the canvas
    edge_pitch: float = 0.6
    px_per_pt: float = 100.0 / 72.0  # the rig draws at 100 dots per inch

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name != "version" and not (type(value) in (int, float) and 0 < value < math.inf):
                do = "Leave it as it is."
                raise ContractError(
                    expected(f"taxel scale {name}", "a number above 0", repr(value)[:80], do)
                )

    def as_dict(self) -> dict[str, object]:
        """Return every scale by name, for storing and hashing."""
        return asdict(self)


@dataclass(frozen=True)
class TaxelDiscs:
    """Where the discs are."""

    centres_px: np.ndarray  # (M, 2) float32, x right and y down in the 480×640 image
    radii_px: np.ndarray  # (M,) float32


def check_counts(
    counts: np.ndarray, name: str = "uSkin counts", wanted: tuple[int, ...] = TAXEL_SHAPE
) -> np.ndarray:
    """Return (M, 3) integer counts as int64.

    Raises ContractError: not an integer array of the ``wanted`` shape, or too large.
    """
    is_array = isinstance(counts, np.ndarray)
    if not is_array or counts.shape != wanted or counts.dtype.kind not in "iu":
        do = (
            "Pass raw integer counts, one row (x, y, z) per taxel; NaN and fractions aren't counts."
        )
        raise ContractError(expected(name, f"integers {wanted}", described(counts), do))
    if max(int(counts.max()), -int(counts.min())) > MOST_COUNTS:
        came = f"{counts.min()} to {counts.max()}"
        raise ContractError(
            expected(name, f"within ±{MOST_COUNTS}", came, "Pass raw counts as they came.")
        )
    return counts.astype(np.int64)  # uint16 would wrap round in the subtraction


def check_alive(counts: np.ndarray, name: str = "uSkin counts") -> np.ndarray:
    """Return ``counts``; raise SensorError if all are zero, which live taxels never are."""
    if not counts.any():
        raise SensorError(
            expected(
                name, "a live scan", f"{counts.size} zeros", "Check power and cable of the sensor."
            )
        )
    return counts


def place_discs(delta_counts: np.ndarray, spec: SensorSpec, scales: TaxelScales) -> TaxelDiscs:
    """Return the discs that (M, 3) counts of a taxel sensor above the reference are drawn as."""
    assert spec.taxels is not None
    delta = _spread(
        delta_counts * np.array(spec.taxels.worth), spec.layout_mm, spec.taxels.spread_mm
    )
    rest_px = CENTRE_PX + spec.layout_mm * np.array(spec.px_per_mm)
    cell_px = np.array(spec.taxels.pitch_mm) * spec.px_per_mm
    shift = delta[:, :2] * (1, -1) * (CELL_PX / scales.counts_per_pitch)  # y down
    limit = scales.shift_max_pitch * cell_px
    edge = scales.edge_pitch * cell_px
    centres_px = np.clip(
        rest_px + np.clip(shift, -limit, limit),
        rest_px.min(axis=0) - edge,
        rest_px.max(axis=0) + edge,
    )
    area = scales.area_rest_pt2 + scales.area_per_count_pt2 * delta[:, 2]
    radii = np.sqrt(np.clip(area, scales.area_rest_pt2, scales.area_max_pt2)) * scales.px_per_pt / 2
    return TaxelDiscs(
        centres_px=centres_px.astype(np.float32),
        radii_px=(radii * np.sqrt(cell_px.prod() / CELL_PX.prod())).astype(np.float32),
    )


def _spread(delta: np.ndarray, layout_mm: np.ndarray, spread_mm: float) -> np.ndarray:
    """Return (M, 3) means of the counts around each taxel, weighted by a Gaussian if spread."""
    if not spread_mm:
        return delta
    apart_mm = np.linalg.norm(layout_mm[:, None] - layout_mm, axis=-1)
    weight = np.exp(-(apart_mm**2) / (2 * spread_mm**2))
    return weight @ delta / weight.sum(axis=1, keepdims=True)


def draw_discs(discs: TaxelDiscs) -> np.ndarray:
    """Return the (480, 640) uint8 image of white discs on black, strictly binary."""
    image = np.zeros(MARKER_IMAGE_SHAPE, np.uint8)
    one = 1 << SUBPIXEL_BITS
    centres = np.rint(discs.centres_px * one).astype(int).tolist()
    radii = np.rint((discs.radii_px - EDGE_PX) * one).astype(int).tolist()
    for centre, radius in zip(centres, radii, strict=True):
        cv2.circle(image, centre, radius, 255, cv2.FILLED, cv2.LINE_8, SUBPIXEL_BITS)
    return image
