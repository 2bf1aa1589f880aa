"""Markers that a camera misses for some frames of a stream stay where they were."""

from unittest.mock import Mock

import numpy as np
import pytest
from contact_samples import faces

from uniforce_vtla.contact import TactileSimulator, free_air
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers import Canonicalizer, marker_reference
from uniforce_vtla.markers.marker_hold import HOLD_FRAMES, MarkerHold
from uniforce_vtla.markers.raster import CENTRE_PX, fill_discs
from uniforce_vtla.sensors.layouts import rectangular

SPACING_px = 20.0
GRID_px = CENTRE_PX + rectangular(20, 28, (SPACING_px, SPACING_px))
MANY = len(GRID_px)


def drawn(points_px):
    return fill_discs(points_px[None], np.full((1, len(points_px)), 9.0))[0]


def filled(hold, points_px, lost=MANY):
    image = drawn(points_px)
    held = hold.fill(image, points_px, lost)
    return image, held


@pytest.fixture
def stream():
    """A canonicalizer of a stream, and the raw reference that it has seen."""
    raw = TactileSimulator("tactip", seed=1).raw_reference()
    canonicalizer = Canonicalizer("tactip", stream=True)
    canonicalizer.set_reference(raw)
    canonicalizer.marker_image(raw)
    return canonicalizer, raw


def without_left(raw, columns):
    """Return a raw frame that shows no marker in so many columns."""
    lacking = raw.copy()
    lacking[:, :columns] = np.median(raw, axis=(0, 1))
    return lacking


def worn(faults, stream=False):
    return WornView(wear(f"tactip:1+{faults}")(0), seed=1, stream=stream)


def pressed(frames):
    """Return a press that grows slowly, as seen from frame to frame at 30 Hz."""
    return faces(np.linspace(0.1, 1, frames)[:, None] * (0.5, 0, 4), side_mm=15.0)


def test_a_marker_is_held_for_a_few_frames_and_then_lost():
    hold = MarkerHold(SPACING_px)
    whole, held = filled(hold, GRID_px)
    assert held == 0
    for _ in range(HOLD_FRAMES):
        image, held = filled(hold, GRID_px[1:])
        assert held == 1 and np.array_equal(image, whole)
    image, held = filled(hold, GRID_px[1:])
    assert held == 0 and np.array_equal(image, drawn(GRID_px[1:]))
    assert filled(hold, GRID_px)[1] == 0  # seen again


@pytest.mark.parametrize("step_px", [1.0, 4.0, 9.0])
def test_markers_in_motion_are_not_drawn_twice(step_px):
    hold = MarkerHold(SPACING_px)
    for shift_px in np.arange(4) * step_px:
        points_px = GRID_px + np.array([shift_px, 0])
        image, held = filled(hold, points_px)
        assert held == 0 and np.array_equal(image, drawn(points_px))


def test_a_pattern_that_jumps_or_goes_is_not_held():
    for now_px in (GRID_px + 0.5 * SPACING_px, GRID_px[: int(0.4 * len(GRID_px))]):
        hold = MarkerHold(SPACING_px)
        filled(hold, GRID_px)
        image, held = filled(hold, now_px)
        assert held == 0 and np.array_equal(image, drawn(now_px))


def test_no_more_markers_are_held_than_are_lost():
    """A sudden press leaves gaps where markers were, and shows all of them elsewhere."""
    pushed_px = GRID_px.copy()
    pushed_px[:5] += 0.7 * SPACING_px
    for lost in (0, 2):
        hold = MarkerHold(SPACING_px)
        filled(hold, GRID_px)
        assert filled(hold, pushed_px, lost)[1] <= lost
    assert lost == filled(hold, GRID_px[lost:], lost)[1]


def test_a_camera_that_moved_since_its_reference_shows_no_old_markers():
    """The reference is the first frame of its stream: without it a fifth missed at once might be
    refused."""
    # the third look in free air may become the new reference
    moved, alone = (
        (worn("shift=2+flicker=0", stream).images(free_air(3))[2] > 0).sum()
        for stream in (True, False)
    )
    assert abs(moved / alone - 1) < 0.02


def test_a_stream_with_missed_markers_shows_what_one_without_shows():
    contact = pressed(12)
    whole = worn("flicker=0")
    expected = whole.images(contact)[4:]

    def off(view):
        """Return which share of the pixels differs, of the reference and of the worst frame."""
        differs = view.images(contact)[4:] != expected
        return np.mean(view.reference != whole.reference), differs.mean(axis=(1, 2)).max()

    held = off(worn("flicker=0.2", stream=True))
    missing = off(worn("flicker=0.2"))
    assert held[0] < 0.01 < missing[0] and held[1] < missing[1] / 3


@pytest.mark.parametrize("sensor", ["gelsight", "tactip"])
def test_a_stream_of_nothing_missed_is_read_as_frames_alone(sensor):
    simulator = TactileSimulator(sensor, seed=1)
    alone = Canonicalizer(sensor)
    stream = Canonicalizer(sensor, stream=True)
    reference = simulator.raw_reference()
    alone.set_reference(reference)
    stream.set_reference(reference)
    slow = simulator.raw_frames(pressed(8))
    at_once = [reference, slow[-1], reference]
    for frame in [*slow, *at_once]:
        assert np.array_equal(alone.marker_image(frame), stream.marker_image(frame))


def test_what_is_held_needs_no_look_at_other_channels(stream, monkeypatch):
    """A look at all five takes longer than a frame at 30 Hz."""
    canonicalizer, raw = stream
    looks = Mock(wraps=marker_reference.segment)
    monkeypatch.setattr(marker_reference, "segment", looks)
    canonicalizer.marker_image(without_left(raw, 270))
    assert looks.call_count == 1 and canonicalizer.match.lost == 0
    assert np.mean(canonicalizer.markers(raw)[:, 0] < 270) > marker_reference.RETRY_SHARE


def test_pairs_are_not_a_stream(stream):
    """Frames that are paired come in any order: a marker missed in one is missed."""
    canonicalizer, raw = stream
    whole, holed = (
        (canonicalizer.pair(raw, frame, "left").current > 0).sum()
        for frame in (raw, without_left(raw, 140))
    )
    assert whole > holed


def test_markers_lost_for_good_are_refused_in_the_end(stream):
    canonicalizer, raw = stream
    half = without_left(raw, 300)
    before = canonicalizer.marker_image(raw)
    for _ in range(HOLD_FRAMES):
        assert np.mean(canonicalizer.marker_image(half) != before) < 0.01
    with pytest.raises(SensorError, match="of the reference"):
        canonicalizer.marker_image(half)
