"""The README's moving picture is small enough, or isn't made in silence."""

import numpy as np
import pytest
from PIL import Image

from benchmarks import wipe_gif


@pytest.fixture(autouse=True)
def noise(monkeypatch):
    frames = np.random.default_rng(0).integers(0, 255, (4, 60, 80, 3), np.uint8)

    def filmed(config, sensor):
        return [wipe_gif.titled(frame, sensor) for frame in frames]

    monkeypatch.setattr(wipe_gif, "filmed", filmed)


def test_sensors_follow_each_other(tmp_path):
    out = tmp_path / "wipe.gif"
    assert wipe_gif.main(["sensors=tactip,uskin:2", f"out={out}"]) == 0
    with Image.open(out) as film:
        assert film.n_frames == 8
        assert film.size == (80, 60 + wipe_gif.TITLE_PX)


def test_a_film_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(wipe_gif, "MOST_MB", 0.001)
    assert wipe_gif.main([f"out={tmp_path / 'wipe.gif'}"]) == 2
