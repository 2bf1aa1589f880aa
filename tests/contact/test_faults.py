"""Faults of worn sensors: each changes what is shown of a press as it says."""

from functools import cache

import numpy as np
import pytest
from contact_samples import faces

from lerobot_env_uniforce_wiping import levels
from uniforce_vtla.contact.faults import CONTROL_HZ, FAULTS
from uniforce_vtla.contact.simulator import free_air
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import SensorError
from uniforce_vtla.sensors import get_sensor


def worn(words):
    return wear(words)(0)


@cache
def view(words):
    return WornView(worn(words), seed=1)


def pressed(force_N=(1.0, 2.0, 6.0)):
    return faces([force_N], side_mm=15.0)


def moved_px(words, contact):
    """Return how a unit's markers moved since its reference was taken."""
    now, before = (
        view(unit).simulator.markers_px(state)[0][0]
        for unit, state in ((words, contact), (words.split("+")[0], free_air(1)))
    )
    return now - before


def counts(words):
    return view(words).simulator.counts(pressed())[0]


def test_a_stiffer_pad_and_a_duller_unit_move_their_markers_less():
    def motion(words):
        return np.nanmax(np.linalg.norm(moved_px(words, pressed()), axis=1))

    usual = motion("tactip:3")
    assert motion("tactip:3+stiffness=2") < 0.7 * usual
    assert motion("tactip:3+gain=0.5") < 0.7 * usual
    # the pad's, too
    assert worn("tactip:3+stiffness=2").stiffness == pytest.approx(2 * worn("tactip:3").stiffness)


def test_a_camera_that_moves_after_the_reference_moves_all_markers_and_leaves_the_reference():
    moved = np.nanmedian(moved_px("tactip:3+shift=1", free_air(1)), axis=0)
    np.testing.assert_allclose(moved, [get_sensor("tactip").px_per_mm[0], 0], atol=1)
    references = [view(words).reference for words in ("tactip:3+shift=1", "tactip:3")]
    np.testing.assert_array_equal(*references)


def test_lost_markers_are_gone_and_dead_ones_stand_still():
    gone = view("tactip:3+lost=0.2+flicker=0").simulator.markers_px(pressed())[0][0, :, 0]
    assert np.isnan(gone).sum() == round(0.2 * len(gone))
    moved = moved_px("tactip:3+dead=0.25+flicker=0", pressed((0, 0, 10)))
    assert (np.linalg.norm(moved, axis=1) < 2).sum() >= round(0.25 * len(moved))
    assert (np.abs(counts("uskin:3+dead=0.25")) < 12).all(axis=1).sum() >= 4


def test_crosstalk_brings_taxels_together():
    apart, together = (counts(words)[:, 2].std() for words in ("uskin:3", "uskin:3+crosstalk=0.5"))
    assert together == pytest.approx(0.5 * apart, rel=0.05)


@pytest.mark.parametrize("words", ["tactip:3", "uskin:3"])
def test_free_air_differs_from_a_reference_taken_under_load(words):
    stale, fresh = (
        (view(unit).images(free_air(1))[0] != view(unit).reference).mean()
        for unit in (f"{words}+stale=6", words)
    )
    assert stale > 1.3 * fresh


def test_steps_of_a_fault_are_those_of_the_scene():
    assert CONTROL_HZ == levels.CONTROL_HZ  # the library knows no scene


def test_light_changes_after_the_reference_and_time_is_in_steps():
    sensor = worn("gelsight:3+light=0.5")
    assert sensor.light_since.gain == pytest.approx([0.5 * g for g in sensor.light.gain])
    late = worn("gelsight:3+lag=100+stall=300+creep=0.3")
    assert late.lag_steps == worn("gelsight:3").lag_steps + 3
    assert (late.stall_steps, late.creep.share) == (9, 0.3)


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
        dose = 100 if fault.unit == "ms" else 0.3
        for kind in ("tactip", "uskin"):
            if get_sensor(kind).signal in fault.signals:
                assert worn(f"{kind}:any+{name}={dose}") != worn(f"{kind}:any")
