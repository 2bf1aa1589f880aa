import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.entry import letterbox, prepare, prepare_tensor


def random_markers(seed: int, shape: tuple[int, ...] = (2, 48, 64)) -> np.ndarray:
    return (np.random.default_rng(seed).random(shape) < 0.2).astype(np.uint8) * 255


def test_keeps_the_aspect_and_centres_on_black() -> None:
    out = prepare(np.full((1, 480, 640), 255, np.uint8), "left", 128)
    assert out.shape == (1, 1, 128, 128) and out.dtype == torch.float32
    assert torch.all(out[:, :, 16:112] == 1) and out[:, :, :16].sum() == 0 and out[:, :, 112:].sum() == 0


@given(seed=st.integers(0, 1000), factor=st.integers(2, 4))
@examples(15)
def test_any_size_of_the_same_picture_gives_the_same_square(seed: int, factor: int) -> None:
    small = random_markers(seed)
    large = small.repeat(factor, axis=1).repeat(factor, axis=2)
    torch.testing.assert_close(prepare(small, "left", 16), prepare(large, "left", 16))


def test_area_average_keeps_the_total_brightness() -> None:
    image = random_markers(0, (1, 480, 640))
    square = prepare(image, "left", 128)
    assert square.sum().item() * 25 == pytest.approx(image.sum() / 255, rel=1e-5)


def test_numpy_tensor_uint8_and_float_agree() -> None:
    image = random_markers(2)
    wanted = prepare(image, "right", 32)
    torch.testing.assert_close(prepare(image.astype(np.float32) / 255, "right", 32), wanted)
    torch.testing.assert_close(prepare_tensor(torch.from_numpy(image), True, 32), wanted)
    torch.testing.assert_close(prepare_tensor(torch.from_numpy(image) / 255, True, 32), wanted)


def test_portrait_images_are_letterboxed_too() -> None:
    out = letterbox(torch.ones(1, 1, 64, 48), 32)
    assert out.sum() == 32 * 24 and out[..., 0].sum() == 0


@pytest.mark.parametrize(
    "images",
    [
        np.zeros((1, 2, 8, 8), np.uint8),
        np.zeros((1, 8, 8), np.int32),
        np.zeros((1, 0, 8), np.uint8),
        np.full((1, 8, 8), np.nan, np.float32),
        np.full((1, 8, 8), 255.0, np.float32),
        np.full((1, 8, 8), -0.1, np.float32),
    ],
)
def test_bad_images_raise(images: np.ndarray) -> None:
    with pytest.raises(ContractError, match="expected"):
        prepare(images, "left", 8)


def test_lists_and_unknown_fingers_raise() -> None:
    with pytest.raises(ContractError):
        prepare([[0, 1]], "left", 8)  # type: ignore[arg-type]
    with pytest.raises(ContractError):
        prepare_tensor(torch.zeros(8, 8), False, 8)
