import copy
import pickle

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.entry import letterbox, prepare
from uniforce_vtla.tokenizer.latent import Latent, pool_latent
from uniforce_vtla.tokenizer.motion import motion_channels, pyramid


def random_markers(seed, shape=(2, 48, 64)):
    return (np.random.default_rng(seed).random(shape) < 0.2).astype(np.uint8) * 255


def test_keeps_the_aspect_and_centres_on_black():
    out = prepare(np.full((1, 480, 640), 255, np.uint8), "left", 128)
    assert out.shape == (1, 1, 128, 128) and out.dtype == torch.float32
    assert torch.all(out[:, :, 16:112] == 1) and out.sum() == 96 * 128


@given(seed=st.integers(0, 1000), factor=st.integers(2, 4))
@examples(15)
def test_any_size_of_the_same_picture_gives_the_same_square(seed, factor):
    small = random_markers(seed)
    large = small.repeat(factor, axis=1).repeat(factor, axis=2)
    torch.testing.assert_close(prepare(small, "left", 16), prepare(large, "left", 16))


def test_area_average_keeps_the_total_brightness():
    image = random_markers(0, (1, 480, 640))
    square = prepare(image, "left", 128)
    assert square.sum().item() * 25 == pytest.approx(image.sum() / 255, rel=1e-5)


def test_numpy_tensor_uint8_and_float_agree():
    image = random_markers(2)
    wanted = prepare(image, "right", 32)
    tensor = torch.from_numpy(image)
    for other in (image.astype(np.float32) / 255, tensor, tensor / 255):
        torch.testing.assert_close(prepare(other, "right", 32), wanted)


def test_portrait_images_are_letterboxed_too():
    out = letterbox(torch.ones(1, 1, 64, 48), 32)
    assert out.sum() == 32 * 24 and out[..., 0].sum() == 0


@pytest.mark.parametrize("value", [np.nan, 255.0, -0.1])
def test_floats_outside_are_refused(value):
    with pytest.raises(ContractError, match="values outside"):
        prepare(np.full((1, 16, 16), value, np.float32), "left", 8)


Z = Latent.of(torch.arange(96.0).view(1, 16, 6), "own")


def test_what_only_picks_joins_and_moves_keeps_the_origin():
    kept = [Z[0], Z[:, None], Z.clone(), Z.cpu(), Z.to(torch.float64), Z.flatten(0, 1)]
    kept += [torch.cat([Z, Z]), torch.stack([Z, Z], dim=1), *Z.unbind(0), *Z, pool_latent(Z, 2)]
    kept += [pickle.loads(pickle.dumps(Z)), copy.deepcopy(Z), Z.expand(3, -1, -1), Z.squeeze(0)]
    assert all(
        isinstance(z, Latent) and z.tokenizer_hash == "own" for z in [*kept, Z.reshape(4, 24)]
    )


def test_what_computes_gives_plain_tensors():
    plain = [Z * 2, Z + Z, Z.mean(), Z @ Z[0].T, torch.where(Z > 3, Z, 0.0), Z - 1]
    assert all(type(z) is torch.Tensor for z in plain) and type(Z.numpy()) is np.ndarray
    assert torch.equal(Z, torch.arange(96.0).view(1, 16, 6))


def test_latents_of_two_origins_join_without_one():
    for other in (Latent.of(torch.zeros(1, 16, 6), "another"), torch.zeros(1, 16, 6)):
        assert type(torch.cat([Z, other])) is type(torch.stack([other, Z])) is torch.Tensor


def test_motion_points_where_the_dots_went(dots):
    reference, *moved = prepare(dots, "left", 64).split(1)
    right, down = (motion_channels(pyramid(reference, 3), now).mean((0, 2, 3)) for now in moved)
    for scale in range(3):
        x, y = 3 * scale + 1, 3 * scale + 2
        assert right[x] > 5 * right[y].abs() and down[y] > 5 * down[x].abs()


def test_nothing_moved_is_exactly_zero(dots):
    image = prepare(dots[:1], "left", 64)
    assert motion_channels(pyramid(image, 3), image).abs().max() == 0


def test_pooling_means_neighbours():
    z = torch.arange(16.0).view(1, 16, 1)
    torch.testing.assert_close(pool_latent(z, 2)[0, :, 0], torch.tensor([2.5, 4.5, 10.5, 12.5]))
    torch.testing.assert_close(pool_latent(z, 4), z)


def test_pooling_refuses_maps_that_are_not_square():
    with pytest.raises(ContractError):
        pool_latent(torch.zeros(1, 6, 6))
