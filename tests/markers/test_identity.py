"""A dome is told from a flat gel by the outline of its markers, whoever built the unit."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.identity import outline, why_not
from uniforce_vtla.sensors import get_sensor

CAMERAS = ("gelsight", "tactip")


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("worn", CAMERAS)
@pytest.mark.parametrize("said", CAMERAS)
def test_each_sensor_is_itself_and_not_the_other(worn: str, said: str, seed: int) -> None:
    frame = TactileSimulator(worn, seed=seed).raw_reference()
    centres = Canonicalizer(said).markers(frame)
    reason = why_not(get_sensor(said), centres, "the finger")
    assert (reason is None) == (worn == said)
    assert reason is None or "check_identity=false" in reason


def test_missing_markers_and_a_stray_blob_change_nothing() -> None:
    spec = get_sensor("tactip")
    points = spec.layout_mm * np.asarray(spec.px_per_mm)
    rng = np.random.default_rng(0)
    some = points[rng.random(len(points)) > 0.15]
    assert why_not(spec, np.concatenate([some, [[300.0, 220.0]]]), "it") is None
    assert why_not(spec, points[:50], "it") is not None, "half the markers is another sensor"


def test_real_gels_have_a_rectangles_outline() -> None:
    rectangle = np.stack(np.meshgrid(np.arange(12), np.arange(9)), -1).reshape(-1, 2).astype(float)
    assert abs(outline(rectangle) - 1.6) < 0.13


@pytest.mark.real
def test_a_real_gelsight_is_one_and_no_tactip() -> None:
    files = sorted((Path(__file__).parents[2].parent / "shared" / "real" / "gelsight_fots").glob("*.png"))
    if not files:
        pytest.skip("no ../shared/real/gelsight_fots here")
    centres = Canonicalizer("gelsight").markers(cv2.imread(str(files[0]))[..., ::-1].copy())
    assert why_not(get_sensor("gelsight"), centres, "it") is None
    assert why_not(get_sensor("tactip"), centres, "it") is not None
