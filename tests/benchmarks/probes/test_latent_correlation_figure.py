from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.probes.latent_correlation import correlations
from benchmarks.probes.latent_correlation_figure import draw_correlations


def content(flip: float) -> dict[str, object]:
    rng = np.random.default_rng(0)
    force = rng.standard_normal((8, 3, 3))
    z = np.concatenate([flip * force, force], axis=-1) + 0.1 * rng.standard_normal((8, 3, 6))
    sensors = {s: correlations(z, force, ["cone", "wave"] * 4) for s in ("one", "two")}
    side = {"axes": [0, 1, 2], "sensors": sensors}
    return {"source": "one", "before": side, "after": side}


def test_figure_shows_the_sign_of_r(tmp_path: Path) -> None:
    pictures = [cv2.imread(str(draw_correlations(content(f), tmp_path / f"{f}.png"))) for f in (1.0, -1.0)]
    assert pictures[0].shape == pictures[1].shape and min(pictures[0].shape[:2]) > 400
    red = [int((p[..., 2].astype(int) - p[..., 0] > 100).sum()) for p in pictures]
    assert red[0] > 1.5 * red[1]
