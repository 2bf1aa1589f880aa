import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers import to_canonical, to_finger_frame

IMAGES = hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=4, max_side=6))


@given(IMAGES)
def test_mirror_twice_is_the_identity_and_left_is_untouched(image):
    assert np.array_equal(to_canonical(to_canonical(image, "right"), "right"), image)
    assert to_canonical(image, "left") is image


@given(IMAGES)
def test_mirror_flips_columns_only_and_torch_agrees(image):
    flipped = to_canonical(image, "right")
    assert np.array_equal(flipped, np.flip(image, axis=-1)) and flipped.flags.c_contiguous
    assert np.array_equal(to_canonical(torch.from_numpy(image), "right").numpy(), flipped)


@given(
    hnp.arrays(
        np.float64, hnp.array_shapes(max_dims=2).map(lambda s: (*s, 3)), elements=st.floats(-20, 20)
    )
)
def test_force_mirror_negates_x_of_the_right_finger_only(force_N):
    own = to_finger_frame(force_N, "right")
    assert np.allclose(own[..., 0], -force_N[..., 0]) and np.array_equal(
        own[..., 1:], force_N[..., 1:]
    )
    assert np.allclose(to_finger_frame(own, "right"), force_N)
    assert to_finger_frame(force_N, "left") is force_N


def test_force_mirror_keeps_the_kind_of_array():
    torch_force = to_finger_frame(torch.tensor([[1.0, 2.0, 3.0]]), "right")
    assert torch_force.dtype == torch.float32 and torch_force.tolist() == [[-1.0, 2.0, 3.0]]
    assert to_finger_frame(np.ones(3, np.float32), "right").dtype == np.float32
    assert to_finger_frame(np.array([1, 2, 3]), "right").tolist() == [-1, 2, 3]


@pytest.mark.parametrize("finger", ["middle", "", None, "Left"])
def test_unknown_finger(finger):
    with pytest.raises(ContractError, match="finger"):
        to_canonical(np.zeros((2, 2)), finger)
    with pytest.raises(ContractError, match="finger"):
        to_finger_frame(np.zeros(3), finger)


@pytest.mark.parametrize("force_N", [np.zeros(2), np.zeros((3, 4)), np.array(1.0)])
def test_malformed_force(force_N):
    with pytest.raises(ContractError, match=r"\(\.\.\., 3\)"):
        to_finger_frame(force_N, "right")


def test_malformed_image():
    with pytest.raises(ContractError, match="H, W"):
        to_canonical(np.zeros(5), "right")
