"""What stand-ins show: free air first, then a press where it was asked for, as the contact simulator says."""

import numpy as np
import pytest

from uniforce_robots.standins.control import MAX_BEHIND_S, Pace
from uniforce_robots.standins.scene import QUARTERS, TAXEL_NOISE_COUNTS, Scene, frame_cycle, taxel_cycle
from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.reference import capture_taxel_reference


def test_a_cycle_begins_in_free_air_and_presses_after():
    scene = Scene(rest_s=1, press_s=2)
    cycle = taxel_cycle(scene, 50)
    assert cycle.shape == (150, 16, 3) and cycle.dtype == np.uint16
    free = capture_taxel_reference(list(cycle[:50]))
    rise = (cycle[:, :, 2].astype(int) - free[:, 2]).max(axis=1)
    assert rise[:50].max() < 6 * TAXEL_NOISE_COUNTS and rise.argmax() == pytest.approx(100, abs=8)
    assert rise.max() > 1000  # 8 N on a patch with 700 counts per newton


def test_what_is_held_is_never_free_and_what_never_presses_always_is():
    pressed, free = taxel_cycle(Scene(hold=True), 20), taxel_cycle(Scene(press_s=0), 20)
    rise = pressed[:, :, 2].astype(int) - free[:, :, 2].mean(axis=0)
    assert (rise.max(axis=1) > 500).all()
    assert np.std(free.astype(float), axis=0).max() < 3 * TAXEL_NOISE_COUNTS


@pytest.mark.parametrize("where", QUARTERS)
def test_a_place_is_where_the_marker_image_shows_it(where: str):
    """A disc grows in the quarter of the marker image that was named."""
    free, pressed = taxel_cycle(Scene(press_s=0), 2)[0], taxel_cycle(Scene(where=where, hold=True), 2)[0]
    pair = Canonicalizer("uskin").pair(free, pressed, "left")
    grown = pair.current.astype(int) - pair.reference
    top, left = where.startswith("top"), where.endswith("left")
    half = grown[:240] if top else grown[240:]
    quarter = half[:, :320] if left else half[:, 320:]
    assert quarter.sum() > 0.4 * np.maximum(grown, 0).sum()


def test_cameras_show_frames_and_taxels_do_not():
    frames = frame_cycle("gelsight", Scene(), 1)
    assert frames.shape == (3, 480, 640, 3) and frames.dtype == np.uint8
    with pytest.raises(ContractError, match="slcan"):
        frame_cycle("uskin", Scene(), 1)
    with pytest.raises(ContractError, match="top-left"):
        taxel_cycle(Scene(where="middle"), 2)


def test_pace_catches_up_and_then_gives_up(monkeypatch: pytest.MonkeyPatch):
    clock = [100.0]
    monkeypatch.setattr("uniforce_robots.standins.control.time.monotonic", lambda: clock[0])
    pace = Pace(100)
    assert pace.due() == 1 and pace.due() == 0 and pace.wait_s() == pytest.approx(0.01)
    clock[0] += 0.055
    assert pace.due() == 5
    clock[0] += 10 * MAX_BEHIND_S
    assert pace.due() == 1
