"""Orders of magnitude of simulated counts against recorded grasps (two uSkins on a Franka hand)."""

from pathlib import Path

import numpy as np
import pytest

from uniforce_vtla.contact import ForceRange, TactileSimulator
from uniforce_vtla.contact.sampling import sample_loads, sample_objects
from uniforce_vtla.contracts import ContactState

TRIALS = Path(__file__).parents[2].parent / "shared" / "real" / "uskin_bilateral_slip" / "data_set"
DROPPED = TRIALS / "data_sample_2022-02-22-15-15-00"  # ends in free air: the object fell

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not DROPPED.exists(), reason=f"recordings not found at {TRIALS}"),
]


def recorded():
    """Return (2, T, 16, 3) raw counts of both fingers."""
    scans = [np.loadtxt(DROPPED / f"xela_sensor{i}.csv", delimiter=",", skiprows=1) for i in (1, 2)]
    T = min(map(len, scans))
    return np.stack([scan[:T].reshape(T, 16, 3) for scan in scans])


def test_baseline_and_noise_are_like_the_recorded_ones():
    free = recorded()[:, -10:]
    simulated = np.median(TactileSimulator("uskin").raw_reference(), axis=0)
    np.testing.assert_allclose(simulated, np.median(free, axis=(0, 1, 2)), rtol=0.1)


def test_counts_in_contact_have_the_recorded_order_of_magnitude():
    scans = recorded()
    real = scans[:, :100] - np.median(scans[:, -10:], axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    force, torsion = sample_loads(rng, 200, ForceRange(normal_N=12.0, shear_N=3.0))
    gap_mm = sample_objects(rng, 200, ["cylinder"], flat_share=1.0).gap_mm
    simulated = TactileSimulator("uskin").counts(ContactState(gap_mm, force, torsion))
    ours, theirs = (np.median(z[z > 300]) for z in (simulated[..., 2], real[..., 2]))
    assert 1 / 3 < ours / theirs < 3
