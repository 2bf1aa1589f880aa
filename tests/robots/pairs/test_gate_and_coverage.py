import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uniforce_robots.pairs.coverage import ENOUGH, Coverage, contact_place
from uniforce_robots.pairs.finger_force import CHANNELS, GRID
from uniforce_robots.pairs.track import MotionLimits, quasi_static
from uniforce_vtla.errors import ContractError

STILL = np.zeros((20, 3))
HELD = np.full(20, 5.0)
LIMITS = MotionLimits()


@pytest.mark.parametrize(("what", "reason"), [("speed", "fast"), ("acceleration", "jerked"), ("grip", "no contact")])
def test_each_limit_closes_it_and_says_why(what: str, reason: str) -> None:
    speed, acceleration, grip = STILL.copy(), STILL.copy(), HELD.copy()
    {"speed": speed, "acceleration": acceleration, "grip": grip}[what][10] = 0.0 if what == "grip" else 2.0
    reasons = quasi_static(speed, acceleration, grip, 30.0, LIMITS)
    assert reasons[10] == reason and not any(reasons[:10])


def test_it_stays_closed_until_the_rubber_has_settled() -> None:
    speed = STILL.copy()
    speed[5] = 1.0
    reasons = quasi_static(speed, STILL, HELD, 30.0, MotionLimits(settle_s=0.1)).tolist()
    assert reasons[6:9] == ["settling"] * 3 and not reasons[9]
    with pytest.raises(ContractError, match="motion limits"):
        MotionLimits(speed_m_s=0.0)


@given(arrays(np.float64, (20, 3), elements=st.floats(-1, 1)), st.integers(1, 20))
def test_it_never_looks_ahead(speed: np.ndarray, count: int) -> None:
    whole = quasi_static(speed, STILL, HELD, 30.0, LIMITS)
    part = quasi_static(speed[:count], STILL[:count], HELD[:count], 30.0, LIMITS)
    assert (whole[:count] == part).all()


@given(
    arrays(np.float64, (30, 3), elements=st.floats(-50, 50)),
    arrays(np.float64, (30, 2), elements=st.floats(-2, 2)),
)
def test_every_pair_counts_once_wherever_it_lies(force: np.ndarray, place: np.ndarray) -> None:
    coverage = Coverage()
    coverage.add(force, place)
    assert coverage.force.sum() == coverage.place.sum() == 30


def test_missing_names_the_emptiest_cell() -> None:
    coverage = Coverage()
    coverage.force += ENOUGH
    coverage.force[3, 1] = 0
    assert coverage.missing() == "grip 6–9 N, pull 0.5–1.5 N"
    assert coverage.covered == pytest.approx(1 - 1 / coverage.force.size)


@pytest.mark.parametrize("cell", [(1, 1), (1, 6), (6, 2)])
def test_the_place_is_where_markers_move_apart(cell: tuple[int, int]) -> None:
    field = np.full((CHANNELS, GRID, GRID), 0.5)  # shear moves all alike
    field[:, cell[0], cell[1]] += 2.0
    x, y = contact_place(field.reshape(1, -1))[0]
    assert (round((y + 1) / 2 * GRID - 0.5), round((x + 1) / 2 * GRID - 0.5)) == cell
