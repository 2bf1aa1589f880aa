import numpy as np
import pytest

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.descriptor import DESCRIPTOR_NAMES, describe


def grid(scale=1.0, shift=(0, 0), size=8, turn=0.0):
    image = np.zeros((200, 240), np.uint8)
    for y in range(-60, 61, 40):
        for x in range(-80, 81, 40):
            column = round(120 + scale * (x - turn * y)) + shift[0] - size // 2
            row = round(100 + scale * (y + turn * x)) + shift[1] - size // 2
            image[row : row + size, column : column + size] = 255
    return image


def named(reference, current):
    return dict(zip(DESCRIPTOR_NAMES, describe(reference, current[None])[0].tolist(), strict=True))


def test_known_shift():
    found = named(grid(), grid(shift=(5, -3)))
    assert found["dx"] == pytest.approx(5) and found["dy"] == pytest.approx(-3)
    assert abs(found["divergence"]) < 1e-6 and abs(found["curl"]) < 1e-6
    assert found["area_change"] == 0 and found["count"] == 1


def test_known_dilation_growth_and_turn():
    assert named(grid(), grid(scale=1.1))["divergence"] == pytest.approx(0.2, abs=0.01)
    assert named(grid(), grid(size=12))["area_change"] == pytest.approx(np.log(12**2 / 8**2))
    assert named(grid(), grid(turn=0.05))["curl"] == pytest.approx(0.1, abs=0.01)


def test_lost_markers_are_counted_and_none_is_no_crash():
    half = grid()
    half[:100] = 0
    assert named(grid(), half)["count"] == pytest.approx(0.5)
    assert named(grid(), np.zeros_like(half)) == dict.fromkeys(DESCRIPTOR_NAMES, 0.0)


def test_bad_references_raise():
    with pytest.raises(ContractError):
        describe(np.zeros((200, 240), np.uint8), grid()[None])
    with pytest.raises(ContractError):
        describe(grid() // 2, grid()[None])
