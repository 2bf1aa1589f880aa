"""References, and later frames held against them: nothing is invented, and losses are reported."""

import itertools
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from uniforce_vtla.contact import SEEN, UNSEEN, TactileSimulator, free_air
from uniforce_vtla.contact.sampling import sample_objects
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.camera_markers import fit_canonical, segment
from uniforce_vtla.markers.marker_reference import REFUSE_SHARE, between_markers
from uniforce_vtla.markers.raster import CENTRE_PX
from uniforce_vtla.markers.reference import ReferenceMemory, capture_taxel_reference
from uniforce_vtla.sensors import get_sensor
from uniforce_vtla.sensors.layouts import rectangular

CAMERAS = ("gelsight", "tactip")


def loaded(n, share=1.0):
    """Return ``n`` contacts of 16 N and 8 N of shear in any direction, or a share of that."""
    rng = np.random.default_rng(n)
    angle = rng.uniform(-np.pi, np.pi, n)
    force = share * np.stack([8 * np.cos(angle), 8 * np.sin(angle), np.full(n, 16.0)], axis=1)
    gap = sample_objects(rng, n, SEEN + UNSEEN, flat_share=0.25).gap_mm
    return ContactState(gap, force.astype(np.float32), np.zeros(n, np.float32))


def remembering(sensor, reference):
    canonicalizer = Canonicalizer(sensor)
    canonicalizer.set_reference(reference)
    return canonicalizer


def free_px(simulator):
    return simulator.markers_px(free_air(1))[0][0]


def dotted(frame, points_px, radius_px, colour):
    """Return a copy of a frame with discs at (N, 2) px, of one colour or one each."""
    frame = frame.copy()
    colours = np.broadcast_to(colour, (len(points_px), 3)).tolist()
    for at, one in zip(np.rint(points_px).astype(int).tolist(), colours, strict=True):
        cv2.circle(frame, at, radius_px, one, cv2.FILLED)
    return frame


def counted(image):
    return cv2.connectedComponents(image)[0] - 1


@pytest.mark.parametrize("seed", range(3))
def test_crumbs_of_light_on_the_outer_pins_are_no_rim(seed):
    simulator = TactileSimulator("tactip", seed=0)
    rng = np.random.default_rng(seed)
    pins_px = free_px(simulator)
    middle = pins_px.mean(axis=0)
    radius = np.hypot(*(pins_px - middle).T).max() * rng.uniform(0.95, 1.04, 20)
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    crumbs_px = middle + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    frame = np.repeat(simulator.reference()[..., None], 3, axis=2)
    frame = dotted(dotted(frame, crumbs_px[::2], 2, 255), crumbs_px[1::2], 3, 255)
    found = Canonicalizer("tactip").markers(frame)
    assert (cKDTree(found).query(pins_px)[0] < 4).all()


@pytest.mark.parametrize("sensor", CAMERAS)
def test_clean_contacts_are_read_as_without_a_reference(sensor):
    """To the pixel, so that what was trained on such images stays valid; and no honest load is
    refused."""
    simulator = TactileSimulator(sensor, seed=3)
    canonicalizer = remembering(sensor, simulator.raw_reference())
    dome = get_sensor(sensor).dome_radius_mm is not None
    plan = canonicalizer._reference.plan
    lost = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for frame in simulator.raw_frames(loaded(52)):
            alone = segment(fit_canonical(frame), dome, plan).image()
            assert np.array_equal(canonicalizer.marker_image(frame), alone)
            match = canonicalizer.match
            assert match.dropped == 0
            lost.append(match.lost / (match.lost + match.matched))
    assert max(lost) < 0.8 * REFUSE_SHARE


@pytest.mark.parametrize("seed", range(4))
def test_coloured_reflections_are_looked_through(seed):
    gel = as_virtual("gelsight")
    layout_mm = rectangular(5, 5, (2.0, 2.0))
    spec = replace(gel.spec, layout_mm=layout_mm, marker_shape="disc", marker_size_mm=0.9)
    reference = TactileSimulator(replace(gel, spec=spec), seed=0).raw_reference()
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:480, :640]
    frame = reference * np.float32(0.5)
    for lobe in range(24):  # eight each in red, green and blue
        at = rng.uniform((220, 140), (420, 340))
        frame[..., lobe % 3] += 150 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * 28**2))
    canonicalizer = remembering("gelsight", reference)
    image = canonicalizer.marker_image(np.clip(frame, 0, 255).astype(np.uint8))
    assert 23 <= counted(image) <= 25 and canonicalizer.match.lost <= 2


def test_lost_markers_are_warned_of_once_and_then_refused():
    reference = TactileSimulator("gelsight", seed=0).raw_reference()
    canonicalizer = remembering("gelsight", reference)
    blurred = cv2.GaussianBlur(reference, (0, 0), 25)

    def half_blind(share):
        blind = int(640 * share)
        return np.concatenate([blurred[:, :blind], reference[:, blind:]], axis=1)

    said = "expected the 80 markers of the reference, got"
    with pytest.warns(UserWarning, match=f"{said} 72"):
        canonicalizer.marker_image(half_blind(0.1))
    assert (canonicalizer.match.matched, canonicalizer.match.lost) == (72, 8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        canonicalizer.marker_image(half_blind(0.1))
    for share, left in ((0.5, 40), (0.75, 16)):
        with pytest.raises(SensorError, match=f"{said} {left} of them"):
            canonicalizer.marker_image(half_blind(share))


@pytest.mark.parametrize("sensor", CAMERAS)
def test_a_plot_is_no_reference(sensor):
    white = np.full((480, 640, 3), 255, np.uint8)
    places_px = CENTRE_PX + rectangular(48, 46, (14, 10))
    with pytest.raises(SensorError, match=r"reference frame: expected .* markers, got 2"):
        remembering(sensor, dotted(white, places_px, 2, (20, 20, 160)))


@pytest.mark.parametrize("known", [True, False], ids=["in the reference", "later"])
def test_reflections_between_pins_are_dropped(known):
    simulator = TactileSimulator("tactip", seed=0)
    pins_px = free_px(simulator)
    triples = pins_px[cKDTree(pins_px).query(pins_px[:64:13], k=3)[1]].mean(axis=1)
    clean = simulator.raw_reference()
    pressed = simulator.raw_frames(loaded(6, share=0.1 if known else 0.03))
    lit, *more_lit = (dotted(frame, triples, 4, 255) for frame in (clean, *pressed))
    canonicalizer = remembering("tactip", lit if known else clean)
    for frame in (lit, *more_lit):
        image = canonicalizer.marker_image(frame)
        assert counted(image) == 127 and canonicalizer.match.lost == 0
        assert 1 <= canonicalizer.match.dropped <= len(triples)  # a pressed pin may run into one


@pytest.mark.parametrize("sensor", [*CAMERAS, "gelsight_d"])
def test_no_marker_of_a_pattern_stands_between_others(sensor):
    points = free_px(TactileSimulator(sensor, seed=0))
    assert not between_markers(points, np.ones(len(points), bool)).any()


FREE = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))


def steady(frames=20, sigma=2.0):
    noise = np.random.default_rng(1).normal(0, sigma, (frames, 16, 3))
    return list(FREE + np.rint(noise).astype(np.int64))


def test_steady_scans_give_their_level_and_one_garbled_is_no_touch():
    scans = steady()
    scans[7][15, 2] -= 286  # seen on a real trial's last frames
    assert np.abs(capture_taxel_reference(scans) - FREE).max() <= 2


def test_a_touch_that_builds_up_is_refused():
    scans = [scan + np.array([0, 0, 40 * i]) for i, scan in enumerate(steady())]
    with pytest.raises(SensorError, match="in contact"):
        capture_taxel_reference(scans)


def test_a_steady_touch_is_refused_against_a_resting_level_only():
    pressed = [scan + np.array([0, 0, 900]) for scan in steady()]
    with pytest.raises(SensorError, match="resting level"):
        capture_taxel_reference(pressed, resting_level=FREE)
    # it can't be known from the scans alone
    assert capture_taxel_reference(pressed).shape == (16, 3)


def test_dead_scans_are_no_reference():
    with pytest.raises(SensorError, match="48 zeros"):
        capture_taxel_reference([np.zeros((16, 3), np.int64)] * 5)


@pytest.mark.parametrize(
    "scans", [[], [FREE, FREE], [FREE, FREE, FREE.astype(float)], [FREE[:3]] * 4]
)
def test_too_few_or_malformed_scans(scans):
    with pytest.raises(ContractError):
        capture_taxel_reference(scans)


def test_steady_camera_frames_give_their_median(gel):
    frame = gel().frame
    noise = np.random.default_rng(0).normal(0, 3, (4, *frame.shape))
    noisy = np.clip(frame + noise, 0, 255).astype(np.uint8)
    reference = Canonicalizer("gelsight").free_air([frame, *noisy])
    assert reference.dtype == np.uint8 and np.abs(reference.astype(int) - frame).mean() < 4


def test_moving_markers_are_no_reference(dome):
    still = dome(rings=6).frame
    moved = np.roll(dome(rings=6, pressed=True).frame, 4, axis=1)
    with pytest.raises(SensorError, match="in contact"):
        Canonicalizer("tactip").free_air([still, still, moved])


def test_missed_markers_are_no_motion(dome):
    """A fifth missed at random in each frame was refused as a touch; the median shows them all."""
    whole = dome(rings=6)
    dark = np.median(whole.frame, axis=(0, 1))
    missed = np.random.default_rng(0).random((10, len(whole.centres_px))) < 0.2
    frames = [dotted(whole.frame, whole.centres_px[some], 10, dark) for some in missed]
    canonicalizer = Canonicalizer("tactip")
    found = canonicalizer.markers(canonicalizer.free_air(frames))
    assert len(found) >= 0.98 * len(whole.centres_px)


def test_too_few_camera_frames_and_frames_of_two_sizes(gel):
    frame = gel().frame
    small = gel(size=(320, 240)).frame
    for frames, says in (([frame] * 2, "at least 3"), ([frame, frame, small], "one size")):
        with pytest.raises(ContractError, match=says):
            Canonicalizer("gelsight").free_air(frames)


@pytest.mark.parametrize("make", [np.array, torch.tensor])
def test_a_reference_is_remembered_by_key_and_content(make):
    """The identity every cache of references goes by: tokenizer, stream, policy and canonicalizer
    share it."""
    memory = ReferenceMemory(2)
    numbers = itertools.count(1)

    def get(key, reference):
        return memory.get(key, reference, lambda: next(numbers))

    first = [[0, 255], [255, 0]]
    image = make(first)
    assert get("left", image) == get("left", make(first)) == 1
    image[0, 0] = 255  # the same object with other content
    assert get("left", image) == 2 and get("left", make(first)) == 1
    assert get("right", image) == 3 and get("left", image[:1]) == 4  # another key, another shape
    assert get("left", image[:1] * 1.0) == 5  # another type
    assert get("left", make(first)) == 6  # two are kept: it is gone
    memory.forget()
    assert get("left", make(first)) == 7


@pytest.mark.parametrize("specks", [60, 200, 300])
@pytest.mark.parametrize("radius_px", [2, 4])
def test_specks_of_a_fuzzy_object_do_not_outvote_the_markers(specks, radius_px):
    """How large a marker is the reference says, and not what most blobs of a frame are."""
    raw = TactileSimulator("gelsight", seed=0).raw_reference()
    rng = np.random.default_rng(specks)
    places_px = rng.integers([150, 100], [500, 380], (specks, 2))
    column, row = places_px.T
    canonicalizer = remembering("gelsight", raw)
    canonicalizer.marker_image(dotted(raw, places_px, radius_px, raw[row, column] // 3))
    assert canonicalizer.match.lost <= 2 and canonicalizer.match.dropped <= specks / 10


@pytest.mark.parametrize("size", [(320, 240), (480, 640), (640, 360)])
def test_a_frame_of_another_size_than_the_reference_is_refused_until_the_reference_is_taken_again(
    gel, size
):
    """A camera set to another size may crop: its markers would lie elsewhere, which passes for
    shear."""
    canonicalizer = remembering("gelsight", gel().frame)
    other = gel(size=size).frame
    with pytest.raises(
        ContractError, match=r"current frame: expected \(480, 640, 3\), got .* reference again"
    ):
        canonicalizer.marker_image(other)
    with pytest.raises(ContractError, match="current frame"):
        canonicalizer.pair(gel().frame, other, "left")
    canonicalizer.set_reference(other)
    assert canonicalizer.marker_image(other).any()
