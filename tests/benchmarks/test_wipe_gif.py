"""The README's moving picture is small enough, or isn't made in silence."""

import numpy as np
import pytest
from PIL import Image

from benchmarks import wipe_gif


@pytest.fixture
def noise(monkeypatch):
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 255, (60, 80, 3), np.uint8) for _ in range(4)]
    monkeypatch.setattr(
        wipe_gif, "filmed", lambda config, sensor: [wipe_gif.titled(f, sensor) for f in frames]
    )


def test_sensors_follow_each_other(tmp_path, noise):
    out = tmp_path / "wipe.gif"
    assert wipe_gif.main(["sensors=tactip,uskin:2", f"out={out}"]) == 0
    with Image.open(out) as film:
        assert film.n_frames == 8
        assert film.size == (80, 60 + wipe_gif.TITLE_PX)


def test_a_film_that_is_too_large_is_refused(tmp_path, noise, monkeypatch):
    monkeypatch.setattr(wipe_gif, "MOST_MB", 0.001)
    assert wipe_gif.main([f"out={tmp_path / 'wipe.gif'}"]) == 2
