"""Faults of worn sensors: each changes what is shown of a press as it says."""

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import levels
from uniforce_vtla.contact.faults import CONTROL_HZ, FAULTS
from uniforce_vtla.contact.simulator import free_air
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import SensorError


def worn(words):
    return wear(words)(0)


def pressed(force_N=(1.0, 2.0, 6.0)):
    gap = free_air(1).gap_mm.copy()
    rows = np.arange(gap.shape[1])
    near = np.abs(rows - rows.mean()) < 6
    gap[0][np.ix_(near, near)] = 0.0
    return ContactState(gap, np.array([force_N], np.float32), np.zeros(1, np.float32))


def markers(words, contact):
    """Return where a unit's markers are now and where they were when its reference was taken, in px."""
    sensor = worn(words)
    now = WornView(sensor, seed=1).simulator.markers_px(contact)[0][0]
    return now, WornView(worn(words.split("+")[0]), seed=1).simulator.markers_px(free_air(1))[0][0]


def test_a_stiffer_pad_and_a_duller_unit_move_their_markers_less():
    def motion(words):
        now, before = markers(words, pressed())
        return float(np.nanmax(np.linalg.norm(now - before, axis=1)))

    usual = motion("tactip:3")
    assert motion("tactip:3+stiffness=2") < 0.7 * usual
    assert motion("tactip:3+gain=0.5") < 0.7 * usual
    # the pad's, too
    assert worn("tactip:3+stiffness=2").stiffness == pytest.approx(2 * worn("tactip:3").stiffness)


def test_a_camera_that_moves_after_the_reference_moves_all_markers_and_leaves_the_reference():
    now, before = markers("tactip:3+shift=1", free_air(1))
    np.testing.assert_allclose(
        np.nanmedian(now - before, axis=0), [worn("tactip").sensor.spec.px_per_mm[0], 0], atol=1
    )
    view, usual = WornView(worn("tactip:3+shift=1"), seed=1), WornView(worn("tactip:3"), seed=1)
    np.testing.assert_array_equal(view.reference, usual.reference)


def test_lost_markers_are_gone_and_dead_ones_stand_still():
    gone, _ = markers("tactip:3+lost=0.2+flicker=0", pressed())
    assert np.isnan(gone[:, 0]).sum() == round(0.2 * len(gone))
    still, before = markers("tactip:3+dead=0.25+flicker=0", pressed((0, 0, 10)))
    assert (np.linalg.norm(still - before, axis=1) < 2).sum() >= round(0.25 * len(still))
    counts = WornView(worn("uskin:3+dead=0.25"), seed=1).simulator.counts(pressed())[0]
    assert (np.abs(counts) < 12).all(axis=1).sum() >= 4


def test_crosstalk_brings_taxels_together():
    def spread(words):
        return float(WornView(worn(words), seed=1).simulator.counts(pressed())[0, :, 2].std())

    assert spread("uskin:3+crosstalk=0.5") == pytest.approx(0.5 * spread("uskin:3"), rel=0.05)


@pytest.mark.parametrize("words", ["tactip:3", "uskin:3"])
def test_free_air_differs_from_a_reference_taken_under_load(words):
    def off(sensor):
        view = WornView(worn(sensor), seed=1)
        return float((view.images(free_air(1))[0] != view.reference).mean())

    assert off(f"{words}+stale=6") > 1.3 * off(words)


def test_steps_of_a_fault_are_those_of_the_scene():
    assert CONTROL_HZ == levels.CONTROL_HZ  # the library knows no scene


def test_light_changes_after_the_reference_and_time_is_in_steps():
    sensor = worn("gelsight:3+light=0.5")
    assert sensor.light_since.gain == pytest.approx([0.5 * g for g in sensor.light.gain])
    late = worn("gelsight:3+lag=100+stall=300+creep=0.3")
    assert (late.lag_steps, late.stall_steps, late.creep.share) == (
        worn("gelsight:3").lag_steps + 3,
        9,
        0.3,
    )


@pytest.mark.parametrize(
    "words, said",
    [
        ("tactip+warp=1", "flicker"),
        ("uskin+flicker=0.1", "crosstalk"),
        ("tactip+lag=soon", "ms"),
        ("tactip+lag", "ms"),
    ],
)
def test_unknown_faults_and_doses_are_named(words, said):
    with pytest.raises(SensorError, match=said):
        wear(words)


def test_every_fault_can_be_worn_in_every_scene():
    for name, fault in FAULTS.items():
        for kind in ("tactip", "uskin"):
            if worn(kind).sensor.spec.signal in fault.signals:
                assert worn(f"{kind}:any+{name}={100 if fault.unit == 'ms' else 0.3}") != worn(
                    f"{kind}:any"
                )
