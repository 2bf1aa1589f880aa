"""Fine-tuning on real grasps: no object trains the tokenizer that reads it, batches are half real, rows are paired."""

from dataclasses import asdict

import numpy as np
import pytest
import torch

from benchmarks.real.grasps import Score
from benchmarks.real.pair_training import (
    ARMS,
    DESCRIPTOR,
    SHIPPED,
    MixedPairs,
    difference,
    half_of,
    table,
)
from uniforce_vtla.tokenizer.pair_cache import Pairs, RecordedPairs

OBJECTS = ("ball", "cup", "mug", "rope", "box")


class Simulated:
    """Pairs whose every pixel is 1."""

    def draw(self, rng: np.random.Generator, units: int, pairs: int) -> Pairs:
        reference = torch.ones(units, 1, 4, 4)
        current = torch.ones(units * pairs, 1, 4, 4)
        return Pairs(reference, reference, current, current)


def recorded() -> RecordedPairs:
    """Return one grasp whose every pixel is 0."""
    black = np.zeros((4, 4), np.uint8)
    currents = np.zeros((5, 4, 4), np.uint8)
    grasp = {
        "left_reference": black,
        "right_reference": black,
        "left_current": currents,
        "right_current": currents,
    }
    return RecordedPairs([grasp])


def test_halves_share_no_object_and_hold_all() -> None:
    halves = [half_of(held, OBJECTS) for held in OBJECTS]
    assert sorted(halves) == [0, 0, 0, 1, 1]
    assert halves == [half_of(held, OBJECTS[::-1]) for held in OBJECTS]


@pytest.mark.parametrize("real_units", [0, 1, 2])
def test_a_batch_holds_so_many_real_grasps(real_units: int) -> None:
    data = MixedPairs(recorded(), Simulated(), real_units)  # type: ignore[arg-type]
    pairs = data.draw(np.random.default_rng(0), 4, 3)
    by_unit = pairs.left_current.reshape(4, -1).mean(dim=1)
    assert by_unit.tolist() == [0.0] * real_units + [1.0] * (4 - real_units)
    assert pairs.right_reference.flatten(1).mean(dim=1).tolist() == by_unit.tolist()


def rows(errors: dict[str, float]) -> list[dict]:
    found = []
    for arm, error in errors.items():
        for seed in range(2 if arm in ARMS else 1):
            for half in (0, 1):
                own = [held for held in OBJECTS if half_of(held, OBJECTS) == half]
                scores = [
                    asdict(Score(held, "close", 9, error + 0.1 * seed, 0.5, 4.0)) for held in own
                ]
                found.append({"arm": arm, "seed": seed, "half": half, "scores": scores})
    return found


def test_errors_are_averaged_over_seeds_and_compared_trial_by_trial() -> None:
    plain, mixed = ARMS
    found = table(rows({SHIPPED: 0.4, DESCRIPTOR: 0.5, plain: 0.4, mixed: 0.1}))
    assert found[mixed]["relative_error"] == pytest.approx(0.15)
    assert found[mixed]["trials"] == len(OBJECTS) == found[mixed]["objects"]
    assert found[mixed]["minus_shipped_95"] == [pytest.approx(-0.25), pytest.approx(-0.25)]
    assert found[SHIPPED]["minus_shipped_95"] == [0.0, 0.0]
    assert found[mixed]["spread"] == 0.0


def test_trials_of_other_objects_are_not_compared() -> None:
    own = [Score("ball", "close", 9, 0.1, 0.5, 4.0)]
    with pytest.raises(ValueError, match="shorter"):
        difference(own, [])
