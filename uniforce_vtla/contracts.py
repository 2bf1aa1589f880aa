"""Data that flows between the stages: shapes, units, frames, and the checks at each boundary.

raw frame → marker image → marker pair → latent → force.  See docs/design.md, "Contracts".
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from uniforce_vtla.errors import ContractError, expected

Finger = Literal["left", "right"]
FINGERS: tuple[Finger, ...] = get_args(Finger)
# of a pad, as its marker image shows it
QUARTERS = ("top-left", "top-right", "bottom-left", "bottom-right")

MARKER_IMAGE_SHAPE = (480, 640)  # rows, columns: the size on disk and from devices
# of a uSkin 4×4, (x, y, z) counts; other taxels say theirs in their SensorSpec
TAXEL_SHAPE = (16, 3)


def check_finger(finger: str) -> Finger:
    """Return ``finger`` if it names one; raise ContractError otherwise."""
    if finger not in FINGERS:
        raise ContractError(
            expected("finger", " or ".join(FINGERS), repr(finger), "Name the finger worn.")
        )
    return finger  # type: ignore[return-value]


def check_count(name: str, value: object, most: int, least: int = 1) -> int:
    """Return ``value`` if it is a whole number from ``least`` to ``most``.

    Raise ContractError otherwise.

    Sizes come from files too: without a limit a damaged one asks for terabytes, or for layers
    without end.
    """
    if type(value) is not int or not least <= value <= most:
        raise ContractError(
            expected(name, f"a whole number from {least} to {most}", repr(value)[:80], "Change it.")
        )
    return value


def check_marker_image(image: np.ndarray, name: str = "marker image") -> np.ndarray:
    """Return ``image`` if it is an (H, W) uint8 array holding only {0, 255}.

    Raises ContractError: wrong rank, dtype, or a value other than 0 and 255.
    """
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype != np.uint8:
        came = f"{getattr(image, 'dtype', type(image).__name__)} {getattr(image, 'shape', '')}"
        raise ContractError(
            expected(name, "(H, W) uint8", came, "Take it from Canonicalizer.marker_image.")
        )
    if image.size == 0:
        raise ContractError(
            expected(name, "a non-empty image", image.shape, "Check the sensor's frame.")
        )
    if np.any((image != 0) & (image != 255)):
        do = "Lossy video or resizing? Store it with crf 0."
        raise ContractError(expected(name, "only 0 and 255", "values between", do))
    return image


@dataclass(frozen=True)
class MarkerPair:
    """A finger's free-air reference and its current marker image, as the sensor sees them.

    Never flipped: the one mirror happens at the tokenizer's entry, keyed by ``finger``.
    """

    reference: np.ndarray  # (480, 640) uint8 in {0, 255}, taken in free air
    current: np.ndarray  # (480, 640) uint8 in {0, 255}
    finger: Finger  # which finger wears the sensor
    sensor: str  # registry name of the sensor; provenance only

    def __post_init__(self) -> None:
        check_finger(self.finger)
        check_marker_image(self.reference, "reference")
        check_marker_image(self.current, "current")
        if self.reference.shape != self.current.shape:
            do = "Use one camera setting for both."
            raise ContractError(expected("pair", self.reference.shape, self.current.shape, do))


@dataclass(frozen=True)
class ContactState:
    """Contacts on one kind of pad, batched; everything in that finger's own image frame.

    Image frame: x = columns to the right, y = rows down, z = into the pad (compression > 0).
    """

    # (B, G, G) float32, the undeformed distance from the pad's tangent plane to the object at each
    # cell of the pad grid; 0 at the point that touches first, ``inf`` where there is no object
    gap_mm: np.ndarray
    # (B, 3) float32, force of the object on the pad: fx, fy shear, fz ≥ 0 compression
    force_N: np.ndarray
    # (B,) float32, moment of the object on the pad about the inward normal z
    torsion_Nmm: np.ndarray

    def __post_init__(self) -> None:
        B = len(self.gap_mm)
        if self.gap_mm.ndim != 3 or self.gap_mm.shape[1] != self.gap_mm.shape[2]:
            raise ContractError(
                expected("gap_mm", "(B, G, G)", self.gap_mm.shape, "Use contact.indenters.")
            )
        if self.force_N.shape != (B, 3) or self.torsion_Nmm.shape != (B,):
            came, do = f"{self.force_N.shape} and {self.torsion_Nmm.shape}", "One row per contact."
            raise ContractError(expected("force_N, torsion_Nmm", f"({B}, 3) and ({B},)", came, do))
        if not (np.isfinite(self.force_N).all() and np.isfinite(self.torsion_Nmm).all()):
            raise ContractError(
                expected("contact force", "finite numbers", "NaN or inf", "Check the simulation.")
            )
        if np.any(self.force_N[:, 2] < 0):
            raise ContractError(
                expected("fz", "≥ 0 N (compression)", self.force_N[:, 2].min(), "Flip its sign.")
            )
