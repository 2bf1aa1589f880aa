"""The fast sampler against LeRobot's own loop: same weights, same noise, same actions."""

from __future__ import annotations

import pytest
import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.policies.rtc.configuration_rtc import RTCConfig

from lerobot_policy_pi05_uniforce.bench import lerobots_layers
from lerobot_policy_pi05_uniforce.fast_prefix import drop_dead
from uniforce_vtla.errors import ContractError

TOLERANCE = 1e-4  # on actions in network units, of order 1


def inputs(policy, batch):
    images, masks = policy._preprocess_images(batch)
    tokens, text_mask = batch["observation.language.tokens"], batch["observation.language.attention_mask"]
    return images, masks, tokens, text_mask


def both(policy, given, noise, steps):
    """Return LeRobot's own loop and ours; adaptive norms start as zeros, so give them something to do."""
    generator = torch.Generator().manual_seed(1)
    for name, p in policy.model.named_parameters():
        if "layernorm.dense" in name or "norm.dense" in name:
            p.data = 0.3 * torch.randn(p.shape, generator=generator)
    return lerobots_own(policy, given, noise, steps), policy.model.sample_actions(
        *given, noise=noise, num_steps=steps
    )


def lerobots_own(policy, given, noise, steps, **rtc):
    """Sample with LeRobot's loop and LeRobot's layers: nothing of ours but the weights and the extra tokens."""
    with lerobots_layers(policy.model):
        return stock.PI05Pytorch.sample_actions(policy.model, *given, noise=noise, num_steps=steps, **rtc)


@pytest.mark.parametrize("site", ["prefix", "suffix"])
@pytest.mark.parametrize("touch", ["none", "latent", "wrench"])
@pytest.mark.parametrize("steps", [1, 10])
def test_equals_the_stock_loop(touch, steps, site, make_policy, make_batch):
    policy = make_policy(touch_input=touch, token_site=site)
    given = inputs(policy, make_batch(policy, size=3))
    noise = torch.randn(3, policy.config.chunk_size, policy.config.max_action_dim)
    slow, fast = both(policy, given, noise, steps)
    assert (slow - noise).abs().max() > 0.05  # the network moves the noise at all
    assert (slow - fast).abs().max() < TOLERANCE


@pytest.mark.parametrize("site", ["prefix", "suffix"])
def test_rows_with_other_prompts_and_a_lost_finger_stay_apart(site, make_policy, make_batch):
    policy = make_policy(touch_input="wrench", token_site=site)
    images, masks, tokens, text_mask = inputs(policy, make_batch(policy, size=3))
    text_mask = text_mask.clone()
    text_mask[1, 12:] = False  # a shorter prompt
    masks = [*masks[:-1], masks[-1] & torch.tensor([True, True, False])]
    noise = torch.randn(3, policy.config.chunk_size, policy.config.max_action_dim)
    slow, fast = both(policy, (images, masks, tokens, text_mask), noise, 4)
    assert fast.isfinite().all()
    assert (slow - fast).abs().max() < TOLERANCE


def test_a_camera_nobody_has_costs_nothing_and_changes_nothing(make_policy, make_batch):
    policy = make_policy(touch_input="none")
    images, masks, tokens, text_mask = inputs(policy, make_batch(policy))
    gone = [masks[0], torch.zeros_like(masks[1]), *masks[2:]]
    noise = torch.randn(2, policy.config.chunk_size, policy.config.max_action_dim)
    slow, fast = both(policy, (images, gone, tokens, text_mask), noise, 4)
    assert (slow - fast).abs().max() < TOLERANCE
    kept = drop_dead(images, gone, tokens, text_mask)
    assert len(kept[0]) == len(images) - 1
    assert kept[2].shape[1] == int(text_mask.sum(dim=1).max()) < tokens.shape[1]


def test_changed_weights_are_noticed(make_policy, make_batch):
    policy = make_policy(touch_input="none")
    given = inputs(policy, make_batch(policy))
    noise = torch.randn(2, policy.config.chunk_size, policy.config.max_action_dim)
    both(policy, given, noise, 4)
    with torch.no_grad():
        for p in policy.model.paligemma_with_expert.gemma_expert.parameters():
            p.mul_(1.3)  # as an optimiser or load_state_dict does
    slow = lerobots_own(policy, given, noise, 4)
    fast = policy.model.sample_actions(*given, noise=noise, num_steps=4)
    assert (slow - fast).abs().max() < TOLERANCE


def test_the_stock_loop_can_be_asked_for(make_policy, make_batch):
    policy = make_policy(touch_input="none", sampler="stock")
    assert policy.model.fast is None
    assert policy.predict_action_chunk(make_batch(policy)).isfinite().all()


def test_real_time_chunking_guides_both_alike(make_policy, make_batch):
    """RTC differentiates through the velocity towards what is left of the chunk before."""
    policy = make_policy(touch_input="none", rtc_config=RTCConfig(enabled=True, execution_horizon=4))
    given = inputs(policy, make_batch(policy))
    noise = torch.randn(2, policy.config.chunk_size, policy.config.max_action_dim)
    free = both(policy, given, noise, 4)[1]
    left = {"prev_chunk_left_over": free[:, 2:, :] + 0.5, "inference_delay": 1, "execution_horizon": 4}
    slow = lerobots_own(policy, given, noise, 4, **left)
    fast = policy.model.sample_actions(*given, noise=noise, num_steps=4, **left)
    assert (fast - free).abs().max() > 0.01  # it was guided at all
    assert (slow - fast).abs().max() < TOLERANCE


def test_touch_is_refreshed_without_looking_again(make_policy, make_batch):
    """What a whole new call would say, had the cameras shown the same."""
    policy = make_policy(touch_input="wrench", token_site="suffix")
    images, masks, tokens, text_mask = inputs(policy, make_batch(policy))
    noise = torch.randn(2, policy.config.chunk_size, policy.config.max_action_dim)
    first = both(policy, (images, masks, tokens, text_mask), noise, 4)[1]
    felt = [*images[:3], *(2 * wrench for wrench in images[3:])]  # two cameras, state, two slots
    network = policy.model
    joint = network.paligemma_with_expert
    joint.embed_image = joint.embed_language_tokens = None  # nobody may run cameras or text
    again = network.fast.refresh(network.suffix_touch(felt[2:], masks[2:]), noise, 4)
    del joint.embed_image, joint.embed_language_tokens
    whole = network.sample_actions(felt, masks, tokens, text_mask, noise=noise, num_steps=4)
    assert (again - first).abs().max() > 1e-3
    assert (again - whole).abs().max() < TOLERANCE


def test_a_refresh_needs_touch_in_the_suffix(make_policy, make_batch):
    policy = make_policy(touch_input="wrench")
    images, masks, tokens, text_mask = inputs(policy, make_batch(policy))
    noise = torch.randn(2, policy.config.chunk_size, policy.config.max_action_dim)
    other = make_policy(touch_input="wrench", token_site="suffix").model
    touch = other.suffix_touch(images[2:], masks[2:])
    with pytest.raises(ContractError, match="sample before"):
        policy.model.fast.refresh(touch, noise, 4)
    policy.model.sample_actions(images, masks, tokens, text_mask, noise=noise, num_steps=4)
    with pytest.raises(ContractError, match="token_site=suffix"):
        policy.model.fast.refresh(touch, noise, 4)


def test_a_policy_reacts_to_touch_between_two_looks(make_policy, make_batch):
    policy = make_policy(touch_input="wrench", token_site="suffix")
    batch = make_batch(policy)
    seen = policy.predict_action_chunk(batch)
    assert torch.allclose(policy.refresh_action_chunk(batch), seen, atol=1e-5)
    harder = {key: 3 * value if "wrench" in key else value for key, value in batch.items()}
    felt = policy.refresh_action_chunk(harder)
    assert (felt - seen).abs().max() > 1e-5
    assert torch.allclose(felt, policy.predict_action_chunk(harder), atol=1e-5)
    with pytest.raises(ContractError, match="Only touch"):
        make_policy(touch_input="none").refresh_action_chunk(batch)
