"""Directions on which fingers agree: found where they are known, whatever each finger adds of its own."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.tokenizer.agreed_directions import MOST, agreed_directions

NUMBERS = 24


def fingers(seed: int, loud: float) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Return shared force (N, 2), two fingers' latents that tell it the same way, their rests, own directions (n, 3).

    Each finger adds ``loud`` times three numbers of its own along directions the fingers don't share force in.
    """
    rng = np.random.default_rng(seed)
    force = rng.standard_normal((1500, 2))
    basis = np.linalg.qr(rng.standard_normal((NUMBERS, 5)))[0]
    rest = rng.standard_normal(NUMBERS)
    told = []
    for _ in range(2):
        own = loud * rng.standard_normal((len(force), 3))
        noise = 0.01 * rng.standard_normal((len(force), NUMBERS))
        told.append(rest + force @ basis[:, :2].T + own @ basis[:, 2:].T + noise)
    return force, told, [rest, rest], basis[:, 2:]


@examples(20)
@given(seed=st.integers(0, 1000), loud=st.floats(0.1, 5.0))
def test_two_directions_hold_the_shared_force_and_nothing_a_finger_adds(seed: int, loud: float) -> None:
    force, told, rests, own = fingers(seed, loud)
    agreed = agreed_directions(told, rests)
    assert agreed.matrix.shape == (NUMBERS, MOST) and (np.diff(agreed.ratios) <= 0).all()
    assert agreed.ratios[1] > 50 > 5 > agreed.ratios[2]  # two numbers are shared, and told as such
    heard = told[0] @ agreed.matrix[:, :2] - agreed.origin[:2]
    design = np.c_[heard, np.ones(len(heard))]
    left = force - design @ np.linalg.lstsq(design, force, rcond=None)[0]
    assert left.std() < 0.1
    assert np.abs(own.T @ agreed.matrix[:, :2]).max() * loud < 0.1  # deaf to the rest


def test_spread_over_grasps_is_one_and_free_air_is_zero() -> None:
    _, told, rests, _ = fingers(0, 1.0)
    agreed = agreed_directions(told, rests)
    assert np.allclose((np.mean(told, axis=0) @ agreed.matrix).std(axis=0, ddof=1), 1.0)
    assert np.allclose(rests[0] @ agreed.matrix - agreed.origin, 0.0)


def test_disagreement_is_what_fingers_of_a_grasp_differ_by() -> None:
    _, told, rests, _ = fingers(2, 1.0)
    agreed = agreed_directions(told, rests)
    heard = np.stack([finger @ agreed.matrix for finger in told])
    own = heard - heard.mean(axis=0)
    within = np.sqrt(np.square(own).sum(axis=(0, 1)) / (own.shape[1] * (own.shape[0] - 1)))
    assert np.allclose(within[2:5], agreed.disagreement[2:5], rtol=0.02)
    assert (within[:2] < agreed.disagreement[:2]).all()  # where they hardly differ the floor is most of it


def test_a_number_that_never_moves_is_not_taken_for_agreement() -> None:
    _, told, rests, _ = fingers(1, 1.0)
    still = [np.c_[finger, np.full(len(finger), 3.0)] for finger in told]
    agreed = agreed_directions(still, [np.r_[rest, 3.0] for rest in rests])
    assert np.isfinite(agreed.matrix).all() and np.abs(agreed.matrix[-1, :2]).max() < 1e-6
