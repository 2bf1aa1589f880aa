from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer.agreement import AGREEMENT, Agreement, fit_agreement

NUMBERS = 24  # a 2 × 2 grid of six numbers


def grasps(seed: int, pairs: int = 1000, shared: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return two sensors' latents of the same grasps, and the (shared, NUMBERS) directions that hold force."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.standard_normal((NUMBERS, NUMBERS)))[0].T
    force = 3 * rng.standard_normal((pairs, shared)) @ basis[:shared]
    own = [force + 1.5 * rng.standard_normal((pairs, NUMBERS - shared)) @ basis[shared:] for _ in range(2)]
    return (*(np.float32(z + 0.1 * rng.standard_normal(z.shape)) for z in own), basis[:shared])


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**16))
def test_force_is_found_among_what_only_one_sensor_shows(seed):
    left, right, force = grasps(seed)
    found = fit_agreement(left, right, 2, "abc")
    best = found.directions[:, :3] / np.linalg.norm(found.directions[:, :3], axis=0)
    assert np.linalg.norm(force @ best, axis=0).min() > 0.95  # each lies in the force's space
    assert found.ratio[2] > 10 * found.ratio[3]
    assert np.allclose(((left + right) / 2 @ found.directions).std(axis=0), 1, rtol=1e-3)


def test_an_offset_of_one_sensor_is_no_agreement():
    left, right, force = grasps(0, shared=1)
    right = right + np.float32(20) * force[0].astype(np.float32)
    assert fit_agreement(left, right, 2, "abc").ratio[0] < fit_agreement(left, left + 0.1, 2, "abc").ratio[0]
    found = fit_agreement(left, right, 2, "abc").directions[:, 0]
    assert abs(force[0] @ found) / np.linalg.norm(found) < 0.5


def test_saved_is_loaded(tmp_path):
    left, right, _ = grasps(1)
    made = fit_agreement(left, right, 2, "abc")
    made.save(tmp_path)
    same = Agreement.load(tmp_path, "abc")
    assert np.array_equal(same.directions, made.directions) and np.array_equal(same.ratio, made.ratio)
    assert (same.grid, [p.name for p in tmp_path.iterdir()]) == (2, [AGREEMENT])


def test_of_another_tokenizer_damaged_or_missing_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match="uniforce-agreement"):
        Agreement.load(tmp_path, "abc")
    left, right, _ = grasps(1)
    path = fit_agreement(left, right, 2, "abc").save(tmp_path)
    with pytest.raises(CheckpointError, match="tokenizer of"):
        Agreement.load(tmp_path, "xyz")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match="directions and their facts"):
        Agreement.load(tmp_path, "abc")
    flat = np.zeros((5, 5), np.float64)
    Agreement(flat, flat[0], 2, "abc").save(tmp_path)
    with pytest.raises(CheckpointError, match="float64"):
        Agreement.load(tmp_path, "abc")


@pytest.mark.parametrize(
    ("injure", "said"),
    [
        (lambda a, b: (a, b[:-1]), "paired latents"),
        (lambda a, b: (a[:20], b[:20]), "grasps"),
        (lambda a, b: (a * np.nan, b), "NaN"),
        (lambda a, b: (a, a), "constant"),
        (lambda a, b: (a * 0, b), "constant"),
    ],
)
def test_grasps_that_decide_nothing_are_refused(injure, said):
    left, right, _ = grasps(2)
    with pytest.raises(ContractError, match=said):
        fit_agreement(*injure(left, right), 2, "abc")
