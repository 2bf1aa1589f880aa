"""One physical unit of a sensor: how it differs from the drawing, within a narrow band."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual


@dataclass(frozen=True)
class UnitVariation:
    """Differences from unit to unit.

    A reference image shows layout and view, so they may vary freely. It can't show stiffness and
    gain: these stay narrow, or an unseen unit's force scale can't be known.
    """

    offset_mm: tuple[float, float] = (0.0, 0.0)  # shift of the marker pattern, x right, y down
    rotation_rad: float = 0.0  # rotation of the pattern, x towards y
    # standard deviation of single markers around the pattern (taxels: not used)
    jitter_mm: float = 0.0
    view_scale: float = 1.0  # magnification of the camera
    stiffness: float = 1.0  # factor on the foundation
    gain: float = 1.0  # factor on marker motion, or on counts
    seed: int = 0  # draws the jitter and, for taxels, baseline and gain per channel
    # factor on the size of every marker: print, threshold and light decide it (cameras)
    marker_size: float = 1.0
    # magnification gained towards the pad's right and lower rim: a camera that isn't square on
    tilt: tuple[float, float] = (0.0, 0.0)
    # of the camera: moves and turns pattern and contact alike; x right, y down, x towards y
    view_shift_mm: tuple[float, float] = (0.0, 0.0)
    view_turn_rad: float = 0.0
    lost: float = 0.0  # share of camera markers that are gone for good
    dead: float = 0.0  # share of markers or taxels that never move: those nearest a random place
    crosstalk: float = 0.0  # part of each taxel's counts that is the mean of all (taxels)

    @classmethod
    def draw(
        cls, rng: np.random.Generator, sensor: str | VirtualSensor, strength: float = 1.0
    ) -> UnitVariation:
        """Return a random unit of ``sensor``; ``strength`` 0: the drawing, 1: the usual spread."""
        shift_mm = 0.6 * strength  # moulding tolerance; ViTac 2024 draws ±1 mm
        turn_rad = 0.03 * strength  # about 2°; ViTac 2024 draws ±.1 rad
        if as_virtual(sensor).spec.signal != "camera":
            shift_mm = 0.3 * strength
            turn_rad = 0.0
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

    def mounted(self, rng: np.random.Generator, look: Look) -> UnitVariation:
        """Return this unit behind a camera mounted at random, as ``seen_through`` draws it.

        In ``seen_through`` the pattern moves on the gel, as in frozen sets. Here the camera moves,
        and with it the place of contact and the direction of shear.
        """
        seen = self.seen_through(rng, look)
        shift_mm = (seen.offset_mm[0] - self.offset_mm[0], seen.offset_mm[1] - self.offset_mm[1])
        turn_rad = seen.rotation_rad - self.rotation_rad
        return replace(
            seen,
            offset_mm=self.offset_mm,
            rotation_rad=self.rotation_rad,
            view_shift_mm=shift_mm,
            view_turn_rad=turn_rad,
        )

    def seen_through(self, rng: np.random.Generator, look: Look) -> UnitVariation:
        """Return this unit seen by a random camera: all that a reference image shows may vary."""
        turn = float(rng.uniform(-1, 1) * look.turn_rad)
        x, y = rng.uniform(-1, 1, 2) * look.shift_mm
        zoom = float(1 + rng.uniform(-1, 1) * look.zoom)
        marker_size = float(rng.uniform(*look.marker_size))
        tilt_x, tilt_y = rng.uniform(-1, 1, 2) * look.tilt
        return replace(
            self,
            offset_mm=(self.offset_mm[0] + float(x), self.offset_mm[1] + float(y)),
            rotation_rad=self.rotation_rad + turn,
            view_scale=self.view_scale * zoom,
            marker_size=marker_size,
            tilt=(float(tilt_x), float(tilt_y)),
        )


@dataclass(frozen=True)
class Look:
    """How freely a camera's view of one unit varies; all of it shows in the reference image."""

    shift_mm: float = 1.0  # the pattern's place, ViTac 2024 draws ±1 mm
    turn_rad: float = 0.10  # ViTac 2024
    zoom: float = 0.06  # another lens distance
    # our own canonicalizer draws 12 to 32 % larger areas
    marker_size: tuple[float, float] = (0.85, 1.30)
    tilt: float = 0.05  # magnification at the rim of a camera about 3° off
