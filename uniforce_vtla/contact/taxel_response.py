"""How magnetic taxels answer to traction: Gaussian-weighted (qx, qy, p) with cross-talk, in counts."""

from __future__ import annotations

import numpy as np

from uniforce_vtla.contact.grid import CELL_AREA_MM2
from uniforce_vtla.contact.materials import TaxelMaterial
from uniforce_vtla.contact.options import ContactOptions
from uniforce_vtla.contact.pads import Pad
from uniforce_vtla.contact.traction import Traction


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

    def __call__(self, traction: Traction, options: ContactOptions) -> np.ndarray:
        """Return (B, 16, 3) float32 counts above the baseline, without noise."""
        p, cells = traction.p_MPa, traction.cells
        B = len(p)
        shear = (traction.q_MPa.reshape(2 * B, -1) @ self._shear[cells]).reshape(B, 2, -1)  # (B, 2, 16)
        if options.cross_talk:
            shear = shear + (p @ self._talk[cells]).reshape(B, 2, -1)
        return np.stack([shear[:, 0], -shear[:, 1], p @ self._normal[cells]], axis=-1) * self._gain
