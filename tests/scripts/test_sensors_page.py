"""The page of one scene with each sensor, in a real browser."""

import numpy as np
import pytest
from headless_browser import open_browser
from lerobot.utils.io_utils import write_video

from uniforce_cli.sensors_page import SensorFilm, write_sensors_page
from uniforce_vtla.evaluation.arms import EpisodeRow
from uniforce_vtla.evaluation.film import FILM_HZ

ROW = EpisodeRow(0, "success", True, False, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0, 0, 0.9)
SPOILT = EpisodeRow(0, "residual", False, True, True, 0.5, 9.0, 12.0, 10.0, 20.0, 30.0, 0, 0.4)
REFUSED = EpisodeRow(0, "aborted", False, False, False, 1.0, 0, 0, 0, 0, 0, 0, 0)
LENGTHS = (12, 8)  # frames


@pytest.fixture
def page_path(tmp_path):
    films = []
    for name, row, length in zip(("TacTip", "uSkin"), (ROW, SPOILT), LENGTHS, strict=True):
        video = tmp_path / f"{name}.mp4"
        shades = np.linspace(0, 255, length).astype(np.uint8)
        frames = [np.full((64, 96, 3), shade) for shade in shades]
        write_video(video, frames, fps=FILM_HZ)
        films.append(SensorFilm(name, video, row, "3 of 4 scenes clean"))
    films.append(SensorFilm("GelSight", tmp_path / "none.mp4", REFUSED, "0 of 4 scenes clean"))
    return write_sensors_page(films, tmp_path / "sensors.html")


def test_it_says_how_each_rollout_ended(page_path):
    text = page_path.read_text()
    assert "<b>TacTip</b>: clean wipe, 90% of the way within the band. 3 of 4 scenes clean." in text
    assert "<b>GelSight</b>: stopped before it began" in text
    assert "residual, slip, too much force, 40% of the way within the band" in text


def test_it_plays_in_a_browser(page_path, tmp_path):
    images = "[...document.querySelectorAll('#films img')]"
    with open_browser(tmp_path / "profile") as page:
        page.open(page_path)
        assert page.read(f"{images}.map((image) => image.naturalWidth)") == [96, 96, 0]
        played = "[...document.querySelectorAll('#films img')].slice(0, 2)"
        first = page.read(f"{played}.map((image) => image.src)")
        page.read("document.getElementById('frame').focus()")
        page.press("ArrowRight", times=LENGTHS[0] - 1)
        last = page.read(f"{played}.map((image) => image.src)")
        assert all(now != before for now, before in zip(last, first, strict=True))
        assert page.read("document.getElementById('time').textContent") == "2.2 s"
        page.click("#play")
        assert page.read("document.getElementById('play').textContent") == "Pause"
        assert page.read("document.documentElement.scrollWidth") <= 1280
        assert not page.complaints
