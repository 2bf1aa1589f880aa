"""Start at the base: with the gate shut touch changes nothing, and it can be learnt open."""

from __future__ import annotations

import pytest
import torch
from policy_samples import OPEN, SITES, alive, inputs, ours, start_noise

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, training
from lerobot_policy_pi05_uniforce.touch.tokens import SHUT
from uniforce_vtla.errors import CheckpointError

AT_START = 1e-5  # stated in docs/design.md: what shut touch may move an action, in network units of order 1


@SITES
@pytest.mark.parametrize("kind", ["fast", "stock"])
def test_the_first_action_is_the_bases(site, kind, make_policy, make_batch):
    settings = {"touch__input": "wrench", "touch__site": site, "sampler__kind": kind}
    policy = alive(make_policy(touch__start_at_base=True, **settings))
    given, noise = inputs(policy, make_batch(policy, size=3)), start_noise(policy, 3)
    base = [part[:3] for part in given[:2]]  # two cameras and the state: touch isn't appended
    without = ours(policy, (*base, *given[2:]), noise)
    assert (ours(policy, given, noise) - without).abs().max() <= AT_START
    alive(policy, gate=OPEN)
    assert (ours(policy, given, noise) - without).abs().max() > 1e-3
    policy.model.touch_gate = None  # the same weights, appended plainly
    assert (ours(policy, given, noise) - without).abs().max() > 100 * AT_START


@SITES
def test_the_gate_has_a_gradient_from_the_first_step(site, make_policy, make_batch):
    policy = alive(make_policy(touch__site=site, touch__start_at_base=True)).train()
    loss, _ = policy(make_batch(policy, actions=True))
    loss.backward()
    shut = policy.model.touch_gate.gate.grad
    others = policy.model.action_in_proj.weight.grad.abs().max()
    assert shut.abs().min() > 1e-4 * others  # of a size an optimiser sees, though the gate is at 1e-6


@SITES
def test_a_short_training_opens_the_gate_where_touch_decides_the_action(
    site, make_policy, make_batch, monkeypatch
):
    """The action is the wrench's first number: without touch the loss can't fall below its variance."""
    monkeypatch.setattr(training, "GATE_LR", 1e-2)
    one = {"touch__slots": {"touch0": "right"}, "action__form": "absolute"}
    policy = make_policy(touch__input="wrench", touch__site=site, touch__start_at_base=True, **one).train()
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
    assert policy.model.touch_gate.gate.abs().item() > 1e-2 > SHUT
    assert losses[-1] < 0.5 * blind < losses[0]


def test_base_starts_at_base_and_the_checkpoint_says_so(make_policy, tmp_path):
    assert PI05UniforceConfig(size="base", device="cpu").touch.start_at_base
    assert not PI05UniforceConfig(size="tiny", device="cpu").touch.start_at_base
    policy = alive(make_policy(touch__start_at_base=True), gate=OPEN)
    policy.save_pretrained(tmp_path)
    again = PI05UniforcePolicy.from_pretrained(tmp_path)
    assert torch.equal(again.model.touch_gate.gate, policy.model.touch_gate.gate)
    config = again.config
    config.touch.start_at_base = False
    with pytest.raises(CheckpointError, match=r"touch_gate\.gate"):
        PI05UniforcePolicy.from_pretrained(tmp_path, config=config)


def test_the_gate_and_what_starts_random_learn_at_their_own_rates(make_policy):
    policy = make_policy(touch__start_at_base=True)
    groups = policy.get_optim_params()
    assert [group.get("lr") for group in groups] == [None, 1e-3, training.GATE_LR]
    assert len(groups[2]["params"]) == 1 and len(groups[1]["params"]) > 5
    trained = {id(p) for group in groups for p in group["params"]}
    assert trained == {id(p) for p in policy.parameters() if p.requires_grad}
