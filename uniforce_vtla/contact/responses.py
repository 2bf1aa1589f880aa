"""How a unit's markers and taxels answer to traction: precomputed influence of grid cells on each of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uniforce_vtla.contact.materials import PadMaterial, TaxelMaterial
from uniforce_vtla.contact.pads import CELL_AREA_MM2, Pad
from uniforce_vtla.contact.traction import Traction


@dataclass(frozen=True)
class ContactOptions:
    """Friction and randomness of a simulated unit."""

    friction: float = 1.0  # Coulomb coefficient of pad against object; rubber on wood or plastic, .8–1.2
    noise: bool = True  # per-marker position noise (camera) or count noise (taxel)
    noise_px: float = 0.3  # standard deviation of a marker's found centre, in pixels of the canonical image
    noise_counts: float = 1.8  # raw standard deviation of real uSkins at rest is 1.1–2.6 counts
    marker_loss: bool = False  # drop single camera markers at random; off: the paper's layouts are complete
    loss_probability: float = 0.01  # per marker and frame (the ViTac 2024 simulation track uses the same)

    def quiet(self) -> ContactOptions:
        """Return these options without randomness."""
        return replace(self, noise=False, marker_loss=False)


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

    def __call__(self, traction: Traction) -> MarkerMotion:
        """Return the motion of all markers under a batch of tractions."""
        B, cells, m = len(traction.p_MPa), traction.cells, self._material
        field = (traction.p_MPa @ self._from_pressure[cells]).reshape(B, 3, -1)  # (B, 3, M)
        drag = (traction.q_MPa.reshape(2 * B, -1) @ self._from_shear[cells]).reshape(B, 2, -1)
        depth = traction.indentation_mm @ self._from_depth[cells]
        depth = depth.reshape(B, -1, len(self._rest_mm))  # (B, 1 or 3, M): w, and for pins ∂w/∂x, ∂w/∂y
        shift = field[:, :2] + drag
        if m.pin_mm:
            shift = shift - m.pin_mm * depth[:, 1:]
        shift = _limited(shift * self._gain, m.stretch_limit_mm).transpose(0, 2, 1)  # (B, M, 2)
        nearer = depth[:, 0] / m.camera_mm  # (B, M): what is pressed towards the camera looks larger
        shift = shift + self._rest_mm * nearer[..., None]
        return MarkerMotion(shift, np.sqrt(1 + field[:, 2]) * (1 + nearer))


def _limited(shift: np.ndarray, limit_mm: float) -> np.ndarray:
    """Stiffen (B, 2, M) motion smoothly so that its length stays below ``limit_mm``."""
    length2 = (shift**2).sum(axis=1, keepdims=True)
    return shift / np.sqrt(1 + length2 / np.float32(limit_mm**2))


def taxel_positions_mm(layout_mm: np.ndarray) -> np.ndarray:
    """Return (16, 2) taxel centres, x right, y down, in the order of the counts.

    Taxel i is rendered at (i mod 4, i div 4) with y up, so the first row of counts is the pad's lowest.
    """
    return layout_mm * np.array([1, -1], dtype=np.float32)


class TaxelResponse:
    """Influence of grid cells on taxels, in counts; image x → count x, image y (down) → minus count y."""

    def __init__(
        self, pad: Pad, taxel_mm: np.ndarray, pitch_mm: float, material: TaxelMaterial, gain: np.ndarray
    ) -> None:
        sigma = material.reach_pitch * pitch_mm
        arm = taxel_mm[None] - pad.position_mm[:, None]  # (C, 16, 2) from cell to taxel
        weight = np.exp(-(arm**2).sum(axis=-1) / (2 * sigma**2)) * CELL_AREA_MM2
        talk = material.cross_talk * material.normal_counts_per_N * weight[..., None] * arm / sigma
        self._normal = (material.normal_counts_per_N * weight).astype(np.float32)  # (C, 16)
        self._shear = (material.shear_counts_per_N * weight).astype(np.float32)
        self._talk = np.concatenate([talk[..., 0], talk[..., 1]], axis=1).astype(np.float32)  # (C, 32)
        self._gain = gain.astype(np.float32)  # (16, 3)

    def __call__(self, traction: Traction) -> np.ndarray:
        """Return (B, 16, 3) float32 counts above the baseline, without noise."""
        p, cells = traction.p_MPa, traction.cells
        B = len(p)
        shear = (traction.q_MPa.reshape(2 * B, -1) @ self._shear[cells]).reshape(B, 2, -1)  # (B, 2, 16)
        shear = shear + (p @ self._talk[cells]).reshape(B, 2, -1)
        return np.stack([shear[:, 0], -shear[:, 1], p @ self._normal[cells]], axis=-1) * self._gain
