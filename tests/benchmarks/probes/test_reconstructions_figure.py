from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.probes.reconstructions import Rig
from benchmarks.probes.reconstructions_figure import draw_reconstructions


def rig(error: float) -> Rig:
    rng = np.random.default_rng(0)
    images = {s: rng.random((3, 32, 32), np.float32) for s in "LR"}
    moved = {s: np.roll(images[s], 3, axis=2) for s in "LR"}
    drawn = {f"{i}->{j}": np.clip(moved[j] - error, 0, 1) for i in "LR" for j in "LR"}
    full = {s: np.zeros((3, 480, 640), np.uint8) for s in "LR"}
    return Rig(("one", "two"), images, moved, full, drawn, np.zeros((3, 3)), ("cone",) * 3)


def test_errors_show_in_colour_and_a_perfect_drawing_has_none(tmp_path: Path) -> None:
    colour = []
    for error in (0.0, 0.5):
        path = draw_reconstructions([rig(error), replace(rig(error))], tmp_path / f"{error}.png", worst=1)
        picture = cv2.imread(str(path)).astype(int)
        colour.append(int((picture[..., 2] - picture[..., 0] > 60).sum()))
    assert colour[0] == 0 and colour[1] > 1000
