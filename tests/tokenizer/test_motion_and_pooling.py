import numpy as np
import pytest
import torch

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.entry import prepare
from uniforce_vtla.tokenizer.latent import pool_latent
from uniforce_vtla.tokenizer.motion import motion_channels, pyramid


def test_motion_points_where_the_dots_went(dots: np.ndarray) -> None:
    reference, right, down = prepare(dots, "left", 64).split(1)
    to_the_right = motion_channels(pyramid(reference, 3), right).mean(dim=(0, 2, 3))
    to_the_bottom = motion_channels(pyramid(reference, 3), down).mean(dim=(0, 2, 3))
    for scale in range(3):
        x, y = 3 * scale + 1, 3 * scale + 2
        assert to_the_right[x] > 5 * to_the_right[y].abs()
        assert to_the_bottom[y] > 5 * to_the_bottom[x].abs()


def test_nothing_moved_is_exactly_zero(dots: np.ndarray) -> None:
    image = prepare(dots[:1], "left", 64)
    assert motion_channels(pyramid(image, 3), image).abs().max() == 0


def test_pooling_means_neighbours() -> None:
    z = torch.arange(16.0).view(1, 16, 1)
    torch.testing.assert_close(pool_latent(z, 2)[0, :, 0], torch.tensor([2.5, 4.5, 10.5, 12.5]))
    torch.testing.assert_close(pool_latent(z, 4), z)


def test_pooling_refuses_maps_that_are_not_square() -> None:
    with pytest.raises(ContractError):
        pool_latent(torch.zeros(1, 6, 6))
