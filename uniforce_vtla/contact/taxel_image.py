"""Counts → disc centres and sizes on the canonical canvas, by the collection script's rule (facts A5)."""

from __future__ import annotations

import numpy as np

_COUNTS_PER_UNIT = 2000.0  # counts that move a disc by one pitch
_CLIP_UNITS = 0.8  # largest motion, in pitches
_AREA_PT2 = (100.0, 6000.0)  # disc area at rest and at most; one point² per count of z
_UNIT_PX = np.array([128.0, 96.0])  # one pitch, x and y: axes −1…4 on 640×480
_PX_PER_PT = 100.0 / 72.0


def taxel_discs(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return disc centres (B, 16, 2) in px (pixel centres at integers) and diameters (B, 16) in px.

    Args:
        counts: (B, 16, 3) above the baseline; x right, y up, z compression.
    """
    index = np.arange(counts.shape[1])
    rest = np.stack([index % 4, index // 4], axis=-1)  # (16, 2), y up
    units = rest + np.clip(counts[..., :2] / _COUNTS_PER_UNIT, -_CLIP_UNITS, _CLIP_UNITS)
    units = np.clip(units, -0.6, 3.6)
    centre = (units + 1) * _UNIT_PX
    centre[..., 1] = 480 - centre[..., 1]
    area = np.clip(_AREA_PT2[0] + counts[..., 2], *_AREA_PT2)
    return centre - 0.5, np.sqrt(area) * _PX_PER_PT
