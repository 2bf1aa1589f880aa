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
    for axis in range(3):
        simulated = TactileSimulator("uskin").raw_reference()[:, axis]
        assert abs(np.median(simulated) / np.median(free[..., axis]) - 1) < 0.1


def test_counts_in_contact_have_the_recorded_order_of_magnitude():
    scans = recorded()
    real = scans[:, :100] - np.median(scans[:, -10:], axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    force, torsion = sample_loads(rng, 200, ForceRange(normal_N=12.0, shear_N=3.0))
    contact = ContactState(
        sample_objects(rng, 200, ["cylinder"], flat_share=1.0).gap_mm, force, torsion
    )
    simulated = TactileSimulator("uskin").counts(contact)
    pressed = [counts[..., 2][counts[..., 2] > 300] for counts in (simulated, real)]
    medians = [float(np.median(values)) for values in pressed]
    assert 1 / 3 < medians[0] / medians[1] < 3, medians
