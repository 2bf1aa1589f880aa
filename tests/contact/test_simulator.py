"""Images of the simulated sensors: signs, mirror, symmetry, seeds, bad input."""

from dataclasses import astuple, replace
from functools import cache

import numpy as np
import pytest
from contact_samples import faces

from uniforce_vtla.contact import (
    ContactOptions,
    TactileSimulator,
    UnitVariation,
    free_air,
    gap_map,
    mirrored,
)
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, ContactState, check_marker_image
from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers.raster import CENTRE_PX
from uniforce_vtla.sensors import get_sensor, list_sensors

SENSORS = pytest.mark.parametrize("sensor", list_sensors())
CAMERAS = pytest.mark.parametrize("sensor", ["gelsight", "tactip"])
QUIET = ContactOptions().quiet()


@cache
def quiet(sensor):
    return TactileSimulator(sensor, options=QUIET)


def contact(force, torsion=0.0, name="sphere", center=(0, 0), angle=0.0):
    gap = gap_map(name, center, angle)[None]
    return ContactState(gap, np.array([force], np.float32), np.array([torsion], np.float32))


def stacked(*contacts):
    return ContactState(*map(np.concatenate, zip(*map(astuple, contacts), strict=True)))


def markers_px(sensor, contact):
    """Return (M, 2) centres that a quiet simulator shows."""
    return quiet(sensor).markers_px(contact)[0][0]


@SENSORS
def test_images_keep_the_contract(sensor):
    simulator = TactileSimulator(sensor)
    images = simulator.marker_images(
        stacked(contact((1, 2, 8)), contact((0, 0, 0)), contact((-2, 1, 16)))
    )
    assert images.shape == (3, *MARKER_IMAGE_SHAPE)
    for image in (*images, simulator.reference()):
        check_marker_image(image)
    centre, size = simulator.markers_px(contact((0, 0, 5)))
    assert centre.shape == (1, *get_sensor(sensor).layout_mm.shape)
    assert size.shape == centre.shape[:2] and (size > 0).all()


@SENSORS
@pytest.mark.parametrize("flat", [False, True])
def test_positive_shear_moves_markers_right_and_down(sensor, flat):
    def middle_px(fx, fy):
        pressed = faces([(fx, fy, 8)], side_mm=20.0) if flat else contact((fx, fy, 8))
        return markers_px(sensor, pressed).mean(axis=0)

    right = middle_px(3, 0) - middle_px(0, 0)
    down = middle_px(0, 3) - middle_px(0, 0)
    assert right[0] > 1 and abs(right[1]) < 0.2 * right[0]
    assert down[1] > 1 and abs(down[0]) < 0.2 * down[1]


@SENSORS
def test_positive_torsion_turns_x_towards_y(sensor):
    arm = markers_px(sensor, free_air(1)) - CENTRE_PX
    turned = markers_px(sensor, contact((0, 0, 12), torsion=20))
    shift = turned - markers_px(sensor, contact((0, 0, 12)))
    assert (arm[:, 0] * shift[:, 1] - arm[:, 1] * shift[:, 0]).sum() > 0


@SENSORS
def test_compression_pushes_outward_and_grows(sensor):
    simulator = quiet(sensor)
    rest, rest_size = simulator.markers_px(free_air(1))
    centre, size = simulator.markers_px(contact((0, 0, 10)))
    if sensor != "paxini":  # it says forces: a gel that is pushed aside presses on nothing
        assert ((centre - rest) * (rest - CENTRE_PX)).sum() > 0
    assert size.mean() > rest_size.mean() and (size >= 0.95 * rest_size).all()


@CAMERAS
def test_right_finger_sees_exactly_the_mirrored_image(sensor):
    left = stacked(
        contact((2, 1, 9), 12.0, "prism", (2.1, -1.3), 0.7),
        contact((-3, 2, 7), -5.0, "pacman", (-1, 3), 2.0),
        contact((0, 0, 0)),
    )
    images = quiet(sensor).marker_images(left)
    opposite = quiet(sensor).marker_images(mirrored(left))
    np.testing.assert_array_equal(opposite, images[:, :, ::-1])


def test_right_uskin_sees_the_mirrored_taxels():
    left = contact((2, 1, 9), 12.0, "prism", (2.1, -1.3), 0.7)
    counts = quiet("uskin").counts(left).reshape(4, 4, 3)
    opposite = quiet("uskin").counts(mirrored(left)).reshape(4, 4, 3)
    np.testing.assert_allclose(opposite, counts[:, ::-1] * [-1, 1, 1], atol=1)
    flipped = quiet("uskin").marker_images(left)[:, :, ::-1]
    differs = quiet("uskin").marker_images(mirrored(left)) != flipped
    # the canonical taxel renderer rounds to whole pixels at disc edges
    assert differs.mean() < 0.002


@CAMERAS
def test_symmetric_press_gives_a_symmetric_image(sensor):
    image = quiet(sensor).marker_images(contact((0, 0, 10)))[0]
    np.testing.assert_array_equal(image, image[:, ::-1])
    np.testing.assert_array_equal(image, image[::-1])


# The pressure of a batch is iterated until its slowest contact has converged, so the others take
# more steps than alone: a cone two more. On one processor shear then differs by up to half a cell's
# own. docs/reasons.md says why this fault stays for now
UNEVEN = pytest.mark.xfail(reason="a batch's contacts converge together", strict=False)


@SENSORS
@pytest.mark.parametrize("third", ["sphere", pytest.param("cone", marks=UNEVEN)])
def test_batch_equals_singles(sensor, third):
    contacts = [
        contact((i - 2, 1, 3.0 * i), 2.0 * i, name)
        for i, name in enumerate(("wave", "dots", third, "line"))
    ]
    batched, _ = TactileSimulator(sensor, seed=3).markers_px(stacked(*contacts))
    single = TactileSimulator(sensor, seed=3)
    singles = np.concatenate([single.markers_px(c)[0] for c in contacts])
    # taxels: counts are rounded, 1 count = .06 px
    np.testing.assert_allclose(batched, singles, atol=0.1)


@SENSORS
def test_same_seed_same_output_other_seed_other_noise(sensor):
    first, again, other = (
        TactileSimulator(sensor, seed=seed).markers_px(contact((1, 0, 6)))[0] for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@SENSORS
def test_no_contact_looks_like_the_reference(sensor):
    for untouched in (free_air(2), contact((0, 0, 0))):
        image = quiet(sensor).marker_images(untouched)[-1]
        np.testing.assert_array_equal(image, quiet(sensor).reference())


@SENSORS
def test_units_differ_and_stay_near_the_drawing(sensor):
    rng = np.random.default_rng(0)
    units = [UnitVariation.draw(rng, sensor) for _ in range(4)]
    press = contact((3, 0, 6))
    shown = [TactileSimulator(sensor, unit, QUIET).markers_px(press)[0] for unit in units]
    nominal = quiet(sensor).markers_px(press)[0]
    assert all(not np.allclose(shown[0], other, atol=0.5) for other in shown[1:])
    assert all(np.abs(other - nominal).mean() < 25 for other in shown)
    assert all(0.9 <= unit.stiffness <= 1.1 and 0.9 <= unit.gain <= 1.1 for unit in units)
    assert UnitVariation.draw(rng, sensor, 0.0).view_scale == 1.0


def test_marker_loss_drops_markers_from_the_image():
    options = replace(QUIET, marker_loss=True, loss_probability=0.3)
    lossy = TactileSimulator("tactip", options=options)
    centre, _ = lossy.markers_px(free_air(1))
    assert 10 < np.isnan(centre[0, :, 0]).sum() < 80
    shown, whole = ((s.marker_images(free_air(1)) > 0).sum() for s in (lossy, quiet("tactip")))
    assert shown < 0.9 * whole


@CAMERAS
def test_raw_camera_frames_show_markers_with_the_right_polarity(sensor):
    simulator = quiet(sensor)
    frame = simulator.raw_reference()
    assert frame.shape == (*MARKER_IMAGE_SHAPE, 3) and frame.dtype == np.uint8
    inner = frame[60:420, 140:500]
    mask = simulator.reference()[60:420, 140:500] > 0
    contrast = inner[mask].mean() / inner[~mask].mean()
    assert contrast < 0.6 if sensor == "gelsight" else contrast > 3


def test_raw_counts_stand_on_a_baseline():
    simulator = quiet("uskin")
    press = contact((0, 0, 12))
    reference = simulator.raw_reference()
    assert reference.shape == (16, 3) and reference.dtype == np.int32 and reference.min() > 1000
    change = simulator.raw_frames(press)[0] - reference
    np.testing.assert_array_equal(change, simulator.counts(press)[0])


def test_strong_grasp_reaches_counts_of_real_grasps():
    """Real uSkins: median 1,007, 99 % 7,071, 99.9 % 10,277 counts of z in contact (facts, section
    C)."""
    on_taxel = contact((0, 0, 12), name="sphere_s", center=(3.07, 2.83))
    assert 4_000 < quiet("uskin").counts(on_taxel)[0, :, 2].max() < 10_300
    on_all = faces(on_taxel.force_N, side_mm=40.0)
    assert 300 < np.median(quiet("uskin").counts(on_all)[0, :, 2]) < 2_500


@SENSORS
def test_bad_gaps_are_refused(sensor):
    press = contact((0, 0, 1))
    for gap_mm, said in (
        (np.full_like(press.gap_mm, np.inf), "an object over the pad"),
        (np.full_like(press.gap_mm, np.nan), "NaN"),
        (np.zeros((1, 20, 20), np.float32), "gap_mm"),
    ):
        with pytest.raises(ContractError, match=said):
            quiet(sensor).marker_images(replace(press, gap_mm=gap_mm))


def test_counts_of_a_camera_are_refused():
    with pytest.raises(ContractError, match="taxel"):
        quiet("gelsight").counts(free_air(1))
