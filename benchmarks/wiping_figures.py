"""Figure of the wiping benchmark: tool height over the wipe."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.evaluation.pictures import PICTURE_DPI
from uniforce_vtla.figure_file import save_figure

PANELS_PER_ROW = 6  # z-profiles that still fit a page
Z_RANGE_MM = (-4.0, 6.0)  # what pressing changes; a look back lifts out of it


def draw_z_profiles(reports: Sequence[ArmReport], path: Path) -> Path:
    """Draw each arm's tool height over the wipe: median, and the middle half of all rollouts as a band.

    A board's height and tilt differ between scenes, so every profile is taken against its own median; medians, since
    a policy that looks back at the board lifts by centimetres between two sweeps.
    """
    shown = [r for r in reports if any(row.z_profile_mm for row in r.rows)]
    columns = min(max(len(shown), 1), PANELS_PER_ROW)
    rows = max(-(-len(shown) // columns), 1)
    figure = Figure(figsize=(1.0 + 2.3 * columns, 0.4 + 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for panel in panels.flat[len(shown) :]:
        panel.axis("off")
    for panel, report in zip(panels.flat, shown, strict=False):
        height = np.array([row.z_profile_mm for row in report.rows if row.z_profile_mm])
        height -= np.median(height, axis=1, keepdims=True)
        share = np.linspace(0, 100, height.shape[1])
        low, middle, high = np.percentile(height, [25, 50, 75], axis=0)
        panel.fill_between(share, low, high, alpha=0.25, color="#2a9d8f")
        panel.plot(share, middle, color="#2a9d8f")
        panel.set_title(f"{report.arm}\nhalf within {np.median(np.abs(height)):.2f} mm", fontsize=9)
        panel.set_ylim(*Z_RANGE_MM)
        panel.set_xlabel("% of the wipe", fontsize=8)
    figure.supylabel("tool height about its median, mm", fontsize=9)
    return save_figure(figure, path, PICTURE_DPI, crop=True)
