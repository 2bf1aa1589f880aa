"""Lights and camera poses drawn while training: what changes, by how much, and what never does."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lerobot_policy_pi05_uniforce.camera_variation import VariationRange, vary

STILL = VariationRange(gain=0, tint=0, contrast=0, shade=0, shift=0, turn_rad=0, zoom=0)


def pictures(count: int = 8, side: int = 56) -> torch.Tensor:
    """Return smooth (count, 3, side, side) pictures in [-1, 1], away from black and white."""
    coarse = torch.rand(count, 3, 7, 7, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.interpolate(coarse, (side, side), mode="bicubic").clamp(0, 1) - 0.5


def test_no_strength_and_no_range_leave_a_picture_as_it_is() -> None:
    images = pictures()
    assert vary(images, 0.0) is images
    assert torch.allclose(vary(images, 1.0, STILL), images, atol=1e-5)


@given(strength=st.floats(0.1, 4.0), side=st.sampled_from([14, 56]))
def test_a_varied_picture_is_a_picture(strength: float, side: int) -> None:
    varied = vary(pictures(4, side), strength)
    assert varied.shape == (4, 3, side, side) and varied.isfinite().all()
    assert varied.min() >= -1 and varied.max() <= 1


def test_every_picture_gets_a_light_of_its_own() -> None:
    one = pictures(1).expand(16, -1, -1, -1)
    means = ((vary(one, 1.0) + 1) / 2).mean(dim=(2, 3))  # (16, 3)
    assert means.std(dim=0).min() > 0.03
    tint = means / means.mean(dim=1, keepdim=True)
    assert tint.std(dim=0).min() > 0.01


@pytest.mark.parametrize(("what", "most_px"), [({"shift": 0.03}, 0.03 * 56), ({"turn_rad": 0.03}, 0.03 * 28)])
def test_a_nudged_camera_moves_the_picture_as_far_as_said(what: dict[str, float], most_px: float) -> None:
    """A ramp across the picture reads the move in pixels at each place."""
    px_per_unit = 28.0
    ramp = torch.linspace(-1, 1, 57)[:-1] + 1 / 56
    images = (0.5 * ramp).expand(64, 3, 56, 56)
    varied = vary(images, 1.0, VariationRange(**{**vars(STILL), **what}))
    moved_px = ((varied - images) / 0.5 * px_per_unit)[:, :, 3:-3, 3:-3].abs()
    assert 0.7 * most_px < moved_px.max() <= most_px * 1.05


def test_training_varies_what_the_cameras_show_and_a_rollout_does_not(make_policy, make_batch) -> None:
    policy = make_policy(touch_input="none", camera_variation=1.0)
    batch = make_batch(policy)
    cameras = len(policy.config.image_features)
    policy.eval()
    plain, again = (policy._preprocess_images(batch)[0] for _ in range(2))
    policy.train()
    varied = policy._preprocess_images(batch)[0]
    for camera in range(cameras):
        assert torch.equal(plain[camera], again[camera])
        assert not torch.allclose(plain[camera], varied[camera], atol=0.01)
    for told in range(cameras, len(plain)):  # the state is no picture
        assert torch.equal(plain[told], varied[told])
