"""A misstated scale is a zoom of the pictures, and its chart has a line per sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.probes.hard_sets import HETERO_HARD, draw_hard
from benchmarks.probes.scale_error import STATED, draw_scale_error, rescaled, scale_error
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig
from uniforce_vtla.tokenizer.settings import TokenizerConfig

RECIPE = replace(HETERO_HARD, sequences=2, length=3, canonicalise=False)


def test_zooming_keeps_the_middle_and_the_size() -> None:
    labelled = draw_hard(RECIPE, as_virtual("gelsight"), 64)
    for zoom in (0.7, 1.3):
        other = rescaled(labelled, zoom)
        assert other.frames.shape == labelled.frames.shape and other.frames.dtype == np.uint8
        ink = [s.reference.astype(float).sum() for s in (other, labelled)]
        if zoom < 1:  # nothing is cut: the markers' area shrinks with the square
            assert ink[0] / ink[1] == np.clip(ink[0] / ink[1], zoom**2 * 0.9, zoom**2 * 1.1)
    same = rescaled(labelled, 1.0)
    assert np.array_equal(same.frames, labelled.frames)


def test_the_chart_holds_every_sensor_and_every_error(tmp_path: Path) -> None:
    sets = {name: draw_hard(RECIPE, as_virtual(name), 128) for name in ("tactip", "uskin")}
    tokenizer = Tokenizer.random(TokenizerConfig(width=16, depth=1, heads=2))
    content = scale_error(tokenizer, Table(sets, sets, HeadTrainingConfig(steps=2)), seeds=1)
    assert set(content["r2"]) == {"tactip", "uskin"}
    assert all(np.shape(r2) == (len(STATED), 3) for r2 in content["r2"].values())
    assert draw_scale_error(content | {"set": "s"}, tmp_path / "scale.png").stat().st_size > 1000
