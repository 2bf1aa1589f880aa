"""Markers that a camera misses for some frames of a stream stay where they were."""

import cv2
import numpy as np
import pytest
from contact_samples import faces

from uniforce_vtla.contact import TactileSimulator, free_air
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers import Canonicalizer, marker_reference
from uniforce_vtla.markers.camera_markers import segment
from uniforce_vtla.markers.marker_hold import HOLD_FRAMES, MarkerHold

SPACING_px = 20.0
GRID_px = np.stack(
    np.meshgrid(np.arange(40, 600, SPACING_px), np.arange(40, 440, SPACING_px)), -1
).reshape(-1, 2)


def drawn(points_px):
    image = np.zeros((480, 640), np.uint8)
    for x, y in np.rint(points_px).astype(int).tolist():
        cv2.circle(image, (x, y), 4, 255, cv2.FILLED)
    return image


def filled(hold, points_px):
    image = drawn(points_px)
    held = hold.fill(image, points_px)
    return image, held


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


def test_a_camera_that_moved_since_its_reference_shows_no_old_markers():
    """The reference is the first frame of its stream: without it a fifth missed at once might be refused."""
    moved = WornView(wear("tactip:1+shift=2+flicker=0")(0), seed=1, stream=True)
    alone = WornView(wear("tactip:1+shift=2+flicker=0")(0), seed=1)
    drawn_px = [(view.images(free_air(3))[2] > 0).sum() for view in (moved, alone)]
    # the third look in free air may become the new reference
    assert abs(drawn_px[0] / drawn_px[1] - 1) < 0.02


def test_a_stream_with_missed_markers_shows_what_one_without_shows():
    contact = pressed(12)
    whole, missing, held = (
        WornView(wear(f"tactip:1+flicker={flicker}")(0), seed=1, stream=stream)
        for flicker, stream in ((0, False), (0.2, False), (0.2, True))
    )
    assert (
        np.mean(held.reference != whole.reference)
        < 0.01
        < np.mean(missing.reference != whole.reference)
    )
    expected = whole.images(contact)[4:]
    off = [
        np.mean(view.images(contact)[4:] != expected, axis=(1, 2)).max() for view in (held, missing)
    ]
    assert off[0] < off[1] / 3


@pytest.mark.parametrize("sensor", ["gelsight", "tactip"])
def test_a_stream_of_nothing_missed_is_read_as_frames_alone(sensor):
    simulator, alone, stream = (
        TactileSimulator(sensor, seed=1),
        Canonicalizer(sensor),
        Canonicalizer(sensor, stream=True),
    )
    reference = simulator.raw_reference()
    for canonicalizer in (alone, stream):
        canonicalizer.set_reference(reference)
    for frame in simulator.raw_frames(pressed(8)):
        assert np.array_equal(alone.marker_image(frame), stream.marker_image(frame))


def test_what_is_held_needs_no_look_at_other_channels(monkeypatch):
    """A look at all five takes longer than a frame at 30 Hz."""
    simulator, stream = TactileSimulator("tactip", seed=1), Canonicalizer("tactip", stream=True)
    raw = simulator.raw_reference()
    stream.set_reference(raw)
    stream.marker_image(raw)
    looks = []
    monkeypatch.setattr(
        marker_reference, "segment", lambda *given: looks.append(given) or segment(*given)
    )
    lacking = raw.copy()
    lacking[:, :270] = np.median(raw, axis=(0, 1)).astype(np.uint8)
    stream.marker_image(lacking)
    assert len(looks) == 1 and stream.match.lost == 0
    assert np.mean(Canonicalizer("tactip").markers(raw)[:, 0] < 270) > marker_reference.RETRY_SHARE


def test_pairs_are_not_a_stream():
    """Frames that are paired come in any order: a marker missed in one is missed."""
    view = WornView(wear("tactip:1+flicker=0")(0), seed=1, stream=True)
    raw, lacking = view.simulator.raw_reference(), view.simulator.raw_reference()
    lacking[150:200, 250:300] = np.median(lacking)
    canonicalizer = view._canonicalizer
    whole, holed = (canonicalizer.pair(raw, frame, "left").current for frame in (raw, lacking))
    assert (whole > 0).sum() > (holed > 0).sum()


def test_markers_lost_for_good_are_refused_in_the_end():
    view = WornView(wear("tactip:1+flicker=0")(0), seed=1, stream=True)
    raw = view.simulator.raw_reference()
    half = raw.copy()
    half[:, :300] = np.median(raw, axis=(0, 1)).astype(np.uint8)
    canonicalizer = view._canonicalizer
    canonicalizer.set_reference(raw)
    before, *_ = canonicalizer.marker_image(raw), canonicalizer.match
    for _ in range(HOLD_FRAMES):
        assert np.mean(canonicalizer.marker_image(half) != before) < 0.01
    with pytest.raises(SensorError, match="of the reference"):
        canonicalizer.marker_image(half)
