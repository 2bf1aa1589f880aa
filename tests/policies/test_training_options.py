"""Each way to train: which weights get a gradient, what is adapted, and what is drawn anew per
sample."""

import importlib.util
import re
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from policy_samples import alive

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.augment import VariationRange, vary

HAS_PEFT = importlib.util.find_spec("peft") is not None
OPTIONS = {
    "full": {},
    "expert_only": {"train_expert_only": True},
    "frozen_vision": {"freeze_vision_encoder": True},
    "no_touch": {"touch__input": "none", "touch__slots": {}},
}
# a key's bias moves all scores of a row alike: its gradient is 0 but for rounding
BY_SYMMETRY = "k_proj.bias"


def without_gradient(policy):
    trained = [(n, p.grad) for n, p in policy.named_parameters() if p.requires_grad]
    assert trained
    lacking = [n for n, grad in trained if grad is None or not grad.abs().max() > 0]
    return [n for n in lacking if not n.endswith(BY_SYMMETRY)]


@pytest.mark.parametrize("gated", [False, True])
@pytest.mark.parametrize("option", OPTIONS)
def test_every_trained_weight_gets_a_gradient(option, gated, make_policy, make_batch):
    """Else data-parallel training without a search for unused parameters would stop at the second
    step."""
    settings = {"touch__start_at_base": gated, "action__objective": "flow"}
    policy = alive(make_policy(**settings | OPTIONS[option]), std=0.1).train()
    policy(make_batch(policy))[0].backward()
    assert without_gradient(policy) == []
    frozen = [n for n, p in policy.named_parameters() if not p.requires_grad]

    def has_frozen(part):
        return any(part in n for n in frozen)

    encoder = policy.model.tactile_encoder
    assert encoder is None or (has_frozen("tactile_encoder") and not encoder.training)
    assert has_frozen("vision_tower") == (option in ("expert_only", "frozen_vision"))
    assert has_frozen("language_model.layers.0") == (option == "expert_only")
    assert has_frozen("language_model.layers.1.mlp")  # the last layer's is not read


@pytest.mark.skipif(not HAS_PEFT, reason="peft isn't installed (an extra of LeRobot's)")
def test_lora_trains_its_targets_and_the_new_modules(make_policy, make_batch, tmp_path):
    make_policy(touch__start_at_base=True, action__objective="flow").save_pretrained(tmp_path)
    policy = PI05UniforcePolicy.from_pretrained(tmp_path)
    policy.config.pretrained_path = tmp_path
    lora = {"method_type": "LORA", "r": 2}
    wrapped = alive(policy.wrap_with_peft(peft_cli_overrides=lora), std=0.1).train()
    for name, p in wrapped.named_parameters():
        if "lora_B" in name:  # starts as zeros: the other half would get no gradient
            torch.nn.init.normal_(p, std=0.1)
    batch = make_batch(policy)
    wrapped(batch)[0].backward()
    assert without_gradient(wrapped) == []
    trained = {n for n, p in wrapped.named_parameters() if p.requires_grad}
    assert all("lora" in n or "modules_to_save" in n for n in trained)
    for part in ("force_tokens", "touch_gate", "time_mlp_in.lora", "mlp.gate_proj.lora"):
        assert any(part in n for n in trained), part
    policy.eval()
    noise = torch.randn(2, 16, 8)
    with_adapters = policy.predict_action_chunk(batch, noise=noise)
    plain = wrapped.merge_and_unload().eval()
    assert plain.model.fast is not None
    assert torch.allclose(with_adapters, plain.predict_action_chunk(batch, noise=noise), atol=1e-4)


def test_lora_names_exist(make_policy):
    """Each target is there to be adapted, peft or not; LeRobot's own list names modules π0.5
    lacks."""
    policy = make_policy(touch__start_at_base=True)
    targets = policy._get_default_peft_targets()
    names = [n for n, m in policy.named_modules() if isinstance(m, torch.nn.Linear)]
    hit = [n for n in names if re.fullmatch(targets["target_modules"], n)]
    assert sum("gemma_expert" in n for n in hit) == 7 * policy.config.tiny.depth
    assert sum("language_model" in n for n in hit) == 2 * policy.config.tiny.depth - 1
    assert sum("_mlp_" in n or "action_" in n for n in hit) == 4
    assert {"force_tokens", "state_token", "touch_gate"} == set(targets["modules_to_save"])


STILL = VariationRange(gain=0, tint=0, contrast=0, shade=0, shift=0, turn_rad=0, zoom=0)


def pictures(count=8, side=56):
    """Return smooth (count, 3, side, side) pictures in [-1, 1], away from black and white."""
    coarse = torch.rand(count, 3, 7, 7, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.interpolate(coarse, (side, side), mode="bicubic").clamp(0, 1) - 0.5


def test_no_strength_and_no_range_leave_a_picture_as_it_is():
    images = pictures()
    assert vary(images, 0.0) is images
    assert torch.allclose(vary(images, 1.0, STILL), images, atol=1e-5)


@given(strength=st.floats(0.1, 4.0), side=st.sampled_from([14, 56]))
def test_a_varied_picture_is_a_picture(strength, side):
    varied = vary(pictures(4, side), strength)
    assert varied.shape == (4, 3, side, side) and varied.isfinite().all()
    assert varied.min() >= -1 and varied.max() <= 1


def test_every_picture_gets_a_light_of_its_own():
    one = pictures(1).expand(16, -1, -1, -1)
    means = ((vary(one, 1.0) + 1) / 2).mean(dim=(2, 3))  # (16, 3)
    assert means.std(dim=0).min() > 0.03
    tint = means / means.mean(dim=1, keepdim=True)
    assert tint.std(dim=0).min() > 0.01


@pytest.mark.parametrize(
    ("what", "most_px"), [({"shift": 0.03}, 0.03 * 56), ({"turn_rad": 0.03}, 0.03 * 28)]
)
def test_a_nudged_camera_moves_the_picture_as_far_as_said(what, most_px):
    """A ramp across the picture reads the move in pixels at each place."""
    px_per_unit = 28.0
    ramp = torch.linspace(-1, 1, 57)[:-1] + 1 / 56
    images = (0.5 * ramp).expand(64, 3, 56, 56)
    varied = vary(images, 1.0, replace(STILL, **what))
    moved_px = ((varied - images) / 0.5 * px_per_unit)[:, :, 3:-3, 3:-3].abs()
    assert 0.7 * most_px < moved_px.max() <= most_px * 1.05


def test_training_varies_what_the_cameras_show_and_a_rollout_does_not(make_policy, make_batch):
    policy = make_policy(touch__input="none", augment__camera_variation=1.0)
    batch = make_batch(policy)

    def shown():
        return torch.stack(policy._preprocess_images(batch)[0])  # (cameras, B, 3, H, W)

    plain, state = shown(), policy.felt(batch).state
    assert torch.equal(shown(), plain)
    policy.train()
    for before, after in zip(plain, shown(), strict=True):
        assert not torch.allclose(before, after, atol=0.01)
    assert torch.equal(policy.felt(batch).state, state)
