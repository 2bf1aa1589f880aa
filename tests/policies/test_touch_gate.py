"""Start at the base: with the gate shut touch changes nothing, and it can be learnt open."""

from __future__ import annotations

import pytest
import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.policies.rtc.configuration_rtc import RTCConfig

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.bench import lerobots_layers
from lerobot_policy_pi05_uniforce.touch_gate import SHUT
from uniforce_vtla.errors import CheckpointError

AT_START = 1e-5  # stated in docs/design.md: what shut touch may move an action, in network units of order 1
FAST = 1e-4  # fast against stock
SITES = pytest.mark.parametrize("site", ["prefix", "suffix"])


def inputs(policy, batch):
    images, masks = policy._preprocess_images(batch)
    return images, masks, batch["observation.language.tokens"], batch["observation.language.attention_mask"]


def alive(policy, gate=None):
    """Let the adaptive norms do something (they start as zeros); open the gate if asked."""
    generator = torch.Generator().manual_seed(1)
    for name, p in policy.model.named_parameters():
        if "norm.dense.weight" in name:
            p.data = 0.3 * torch.randn(p.shape, generator=generator)
    if gate is not None:
        policy.model.touch_gate.gate.data[:] = torch.tensor(gate)
    return policy


def lerobots_own(policy, given, noise, steps=4, **rtc):
    with lerobots_layers(policy.model):
        return stock.PI05Pytorch.sample_actions(policy.model, *given, noise=noise, num_steps=steps, **rtc)


def start(policy, size):
    return torch.randn(size, policy.config.chunk_size, policy.config.max_action_dim)


@SITES
@pytest.mark.parametrize("sampler", ["fast", "stock"])
def test_the_first_action_is_the_bases(site, sampler, make_policy, make_batch):
    settings = {"touch_input": "wrench", "token_site": site, "sampler": sampler}
    policy = alive(make_policy(start_at_base=True, **settings))
    given = inputs(policy, make_batch(policy, size=3))
    noise = start(policy, 3)
    base = [part[:3] for part in given[:2]]  # two cameras and the state: touch isn't appended
    without = policy.model.sample_actions(*base, *given[2:], noise=noise, num_steps=4)
    felt = policy.model.sample_actions(*given, noise=noise, num_steps=4)
    assert (felt - without).abs().max() <= AT_START
    policy.model.touch_gate = None  # the same weights, appended plainly
    plain = policy.model.sample_actions(*given, noise=noise, num_steps=4)
    assert (plain - without).abs().max() > 100 * AT_START


@SITES
def test_an_open_gate_is_sampled_alike(site, make_policy, make_batch):
    policy = alive(make_policy(touch_input="wrench", token_site=site, start_at_base=True), gate=[0.6, 1.5])
    images, masks, tokens, text_mask = inputs(policy, make_batch(policy, size=3))
    text_mask = text_mask.clone()
    text_mask[1, 12:] = False  # a shorter prompt, and a finger lost in the last row
    masks = [*masks[:-1], masks[-1] & torch.tensor([True, True, False])]
    given, noise = (images, masks, tokens, text_mask), start(policy, 3)
    slow, fast = (
        lerobots_own(policy, given, noise),
        policy.model.sample_actions(*given, noise=noise, num_steps=4),
    )
    assert (slow - fast).abs().max() < FAST
    alive(policy, gate=[SHUT, SHUT])
    shut = policy.model.sample_actions(*given, noise=noise, num_steps=4)
    assert (fast - shut).abs().max() > 1e-3  # it was open


@SITES
def test_one_row_alone_is_sampled_alike(site, make_policy, make_batch):
    policy = alive(make_policy(touch_input="wrench", token_site=site, start_at_base=True), gate=[0.6, 1.5])
    given = inputs(policy, make_batch(policy, size=1))
    noise = start(policy, 1)
    fast = policy.model.sample_actions(*given, noise=noise, num_steps=4)
    assert (lerobots_own(policy, given, noise) - fast).abs().max() < FAST


@SITES
def test_training_sees_the_velocity_that_sampling_follows(site, make_policy, make_batch):
    policy = alive(make_policy(touch_input="wrench", token_site=site, start_at_base=True), gate=[0.6, 1.5])
    given = inputs(policy, make_batch(policy))
    noise = start(policy, 2)
    one_step = policy.model.sample_actions(*given, noise=noise, num_steps=1)  # noise − velocity at time 1
    squared = policy.model.forward(
        *given, torch.zeros_like(noise), noise, torch.ones(2)
    )  # (noise − velocity)²
    assert torch.allclose(squared, one_step.square(), atol=1e-4)


@SITES
def test_the_gate_feels_a_gradient_from_the_first_step(site, make_policy, make_batch):
    policy = alive(make_policy(touch_input="latent", token_site=site, start_at_base=True)).train()
    loss, _ = policy(make_batch(policy, actions=True))
    loss.backward()
    shut = policy.model.touch_gate.gate.grad
    others = policy.model.action_in_proj.weight.grad.abs().max()
    assert shut.abs().min() > 1e-4 * others  # of a size an optimiser sees, though the gate is at 1e-6
    tokens = {n: p.grad for n, p in policy.model.force_tokens.named_parameters()}
    assert all(grad is not None and grad.abs().max() > 0 for grad in tokens.values())


@SITES
def test_a_short_training_opens_the_gate_where_touch_tells_the_action(site, make_policy, make_batch):
    """The action is the wrench's first number: without touch the loss can't fall below its variance."""
    one = {"touch_slots": {"touch0": "right"}, "action_form": "absolute", "touch_gate_lr": 1e-2}
    policy = make_policy(touch_input="wrench", token_site=site, start_at_base=True, **one).train()
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    batch = make_batch(policy, size=16, actions=True)
    wrench = torch.randn(16, 4)
    batch["observation.wrench.touch0"] = 5 * wrench
    batch["action"] = wrench[:, None, :1].expand_as(batch["action"]).clamp(-2, 2)
    for key, value in batch.items():  # nothing but touch differs between rows
        if key.startswith("observation.") and "wrench" not in key:
            batch[key] = value[:1].expand_as(value)
    losses = []
    for _ in range(50):
        loss, _ = policy(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    blind = float(batch["action"][:, 0, 0].var())
    assert policy.model.touch_gate.gate.abs().item() > 1e-2
    assert losses[-1] < 0.5 * blind < losses[0]


def test_real_time_chunking_guides_both_alike(make_policy, make_batch):
    rtc = RTCConfig(enabled=True, execution_horizon=4)
    settings = {"touch_input": "wrench", "rtc_config": rtc, "start_at_base": True}
    policy = alive(make_policy(**settings), gate=[0.6, 1.5])
    given, noise = inputs(policy, make_batch(policy)), start(policy, 2)
    free = policy.model.sample_actions(*given, noise=noise, num_steps=4)
    left = {"prev_chunk_left_over": free[:, 2:] + 0.5, "inference_delay": 1, "execution_horizon": 4}
    fast = policy.model.sample_actions(*given, noise=noise, num_steps=4, **left)
    assert (fast - free).abs().max() > 0.01
    assert (lerobots_own(policy, given, noise, **left) - fast).abs().max() < FAST


def test_touch_is_refreshed_behind_a_gate(make_policy, make_batch):
    settings = {"touch_input": "wrench", "token_site": "suffix", "start_at_base": True}
    policy = alive(make_policy(**settings), gate=[0.6, 1.5])
    batch = make_batch(policy)
    seen = policy.predict_action_chunk(batch)
    harder = {key: 3 * value if "wrench" in key else value for key, value in batch.items()}
    felt = policy.refresh_action_chunk(harder)
    assert (felt - seen).abs().max() > 1e-5
    assert torch.allclose(felt, policy.predict_action_chunk(harder), atol=1e-5)


def test_base_starts_at_base_and_the_checkpoint_says_so(make_policy, tmp_path):
    assert PI05UniforceConfig(size="base", device="cpu").start_at_base
    assert not PI05UniforceConfig(size="tiny", device="cpu").start_at_base
    policy = alive(make_policy(start_at_base=True), gate=[0.6, 1.5])
    policy.save_pretrained(tmp_path)
    again = PI05UniforcePolicy.from_pretrained(tmp_path)
    assert torch.equal(again.model.touch_gate.gate, policy.model.touch_gate.gate)
    config = again.config
    config.start_at_base = False
    with pytest.raises(CheckpointError, match=r"touch_gate\.gate"):
        PI05UniforcePolicy.from_pretrained(tmp_path, config=config)


def test_the_gate_learns_at_its_own_rate(make_policy):
    policy = make_policy(start_at_base=True, touch_gate_lr=0.5, new_module_lr=0.25)
    groups = {group.get("lr"): len(group["params"]) for group in policy.get_optim_params()}
    assert groups[0.5] == 1 and groups[0.25] > 5
    assert sum(groups.values()) == sum(p.requires_grad for p in policy.parameters())
