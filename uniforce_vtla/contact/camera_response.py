"""How markers under a skin move when traction acts on it: precomputed influence of grid cells on markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.grid import CELL_AREA_MM2
from uniforce_vtla.contact.materials import PadMaterial
from uniforce_vtla.contact.options import ContactOptions
from uniforce_vtla.contact.pads import Pad
from uniforce_vtla.contact.traction import Traction


@dataclass(frozen=True)
class MarkerMotion:
    """Motion of M markers: ``shift_mm`` (B, M, 2) on the surface, ``growth`` (B, M) factor on their size."""

    shift_mm: np.ndarray
    growth: np.ndarray


class CameraResponse:
    """Influence matrices of one unit. Linear in traction, then limited by the material's stretch.

    Field by field: outward push of pressure (FOTS' dilation, as a superposition over cells), growth of area,
    inward displacement w and its slope (from the indentation p/k, blurred by the skin), drag of shear.
    """

    def __init__(self, pad: Pad, rest_mm: np.ndarray, material: PadMaterial, gain: float = 1.0) -> None:
        arm = rest_mm[None] - pad.position_mm[:, None]  # (C, M, 2) from cell to marker
        r2 = (arm**2).sum(axis=-1)
        A, m = CELL_AREA_MM2, material
        push = m.dilation_per_N * np.exp(-r2 / m.dilation_radius_mm**2) * A
        blur = np.exp(-r2 / (2 * m.skin_blur_mm**2)) * A / (2 * np.pi * m.skin_blur_mm**2)
        local = [push * arm[..., 0], push * arm[..., 1], m.area_per_N * np.exp(-r2 / m.area_radius_mm**2) * A]
        slope = [-blur * arm[..., axis] / m.skin_blur_mm**2 for axis in (0, 1)]
        near, wide = (np.exp(-r2 / radius**2) for radius in m.drag_radii_mm)
        drag = m.drag_mm_per_N * (m.drag_local_share * near + (1 - m.drag_local_share) * wide) * A
        self._rest_mm, self._material, self._gain = rest_mm, material, gain
        self._from_pressure = np.concatenate(local, axis=1).astype(np.float32)  # (C, 3·M)
        self._from_depth = np.concatenate([blur, *slope] if m.pin_mm else [blur], axis=1).astype(np.float32)
        self._from_shear = drag.astype(np.float32)  # (C, M)

    def __call__(self, traction: Traction, options: ContactOptions) -> MarkerMotion:
        """Return the motion of all markers under a batch of tractions."""
        B, cells = len(traction.p_MPa), traction.cells
        field = (traction.p_MPa @ self._from_pressure[cells]).reshape(B, 3, -1)  # (B, 3, M)
        drag = (traction.q_MPa.reshape(2 * B, -1) @ self._from_shear[cells]).reshape(B, 2, -1)
        depth = self._depth(traction)  # w, and for pins ∂w/∂x, ∂w/∂y
        shift = field[:, :2] + drag
        if options.pin_lever and self._material.pin_mm:
            shift = shift - self._material.pin_mm * depth[:, 1:]
        shift = _limited(shift * self._gain, self._material.stretch_limit_mm).transpose(0, 2, 1)  # (B, M, 2)
        growth = np.sqrt(1 + field[:, 2])
        if options.perspective:
            nearer = depth[:, 0] / self._material.camera_mm  # (B, M)
            shift = shift + self._rest_mm * nearer[..., None]
            growth = growth * (1 + nearer)
        return MarkerMotion(shift, growth)

    def _depth(self, traction: Traction) -> np.ndarray:
        depth = traction.indentation_mm @ self._from_depth[traction.cells]
        return depth.reshape(len(depth), -1, len(self._rest_mm))  # (B, 1 or 3, M)


def _limited(shift: np.ndarray, limit_mm: float) -> np.ndarray:
    """Stiffen (B, 2, M) motion smoothly so that its length stays below ``limit_mm``."""
    length2 = (shift**2).sum(axis=1, keepdims=True)
    return shift / np.sqrt(1 + length2 / np.float32(limit_mm**2))
