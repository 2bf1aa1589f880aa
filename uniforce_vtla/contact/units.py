"""One physical unit of a sensor: how it differs from the drawing, within a narrow band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.sensors import get_sensor


@dataclass(frozen=True)
class UnitVariation:
    """What differs from unit to unit.

    What a reference image shows (layout, view) may vary freely; what it can't show (stiffness, gain) stays
    narrow, else an unseen unit's force scale can't be told from its picture.

    Attributes:
        offset_mm: shift of the marker pattern, x right, y down.
        rotation_rad: rotation of the pattern, x towards y.
        jitter_mm: standard deviation of single markers around the pattern (taxels: not used).
        view_scale: magnification of the camera.
        stiffness: factor on the foundation.
        gain: factor on marker motion, or on counts.
        seed: draws the jitter and, for taxels, baseline and gain per channel.
    """

    offset_mm: tuple[float, float] = (0.0, 0.0)
    rotation_rad: float = 0.0
    jitter_mm: float = 0.0
    view_scale: float = 1.0
    stiffness: float = 1.0
    gain: float = 1.0
    seed: int = 0

    @classmethod
    def draw(cls, rng: np.random.Generator, sensor: str, strength: float = 1.0) -> UnitVariation:
        """Return a random unit of ``sensor``; ``strength`` 0 gives the drawing, 1 the usual spread."""
        taxel = get_sensor(sensor).signal == "taxel"
        shift_mm = (0.3 if taxel else 0.6) * strength  # moulding tolerance; ViTac 2024 draws ±1 mm
        turn_rad = (0.0 if taxel else 0.03) * strength  # about 2°; ViTac 2024 draws ±.1 rad
        x, y = rng.uniform(-shift_mm, shift_mm, 2)
        return cls(
            offset_mm=(float(x), float(y)),
            rotation_rad=float(rng.uniform(-1, 1) * turn_rad),
            jitter_mm=0.1 * strength,  # ViTac 2024: .1 mm per marker
            view_scale=float(1 + rng.uniform(-0.03, 0.03) * strength),
            stiffness=float(1 + rng.uniform(-0.1, 0.1) * strength),
            gain=float(1 + rng.uniform(-0.1, 0.1) * strength),
            seed=int(rng.integers(2**31)),
        )
