"""Each way to train: who gets a gradient, who doesn't, and that nobody waits for one that never comes."""

from __future__ import annotations

import importlib.util

import pytest
import torch
from lerobot.configs import FeatureType

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from uniforce_vtla.errors import ContractError
from uniforce_vtla.keys import next_latent_key

HAS_PEFT = importlib.util.find_spec("peft") is not None
OPTIONS = {
    "full": {},
    "expert_only": {"train_expert_only": True},
    "frozen_vision": {"freeze_vision_encoder": True},
    "whole_pad": {"hear_whole_pad": True},
    "next_force": {"next_force_weight": 0.5},
    "no_touch": {"touch_input": "none", "touch_slots": {}},
}
BY_SYMMETRY = (
    "k_proj.bias"  # a key's bias moves all scores of a row alike: its gradient is 0 but for rounding
)


def alive(policy):
    """Adaptive norms start as zeros, which shut the expert's residuals and their gradients."""
    for name, p in policy.named_parameters():
        if "norm.dense.weight" in name:
            torch.nn.init.normal_(p, std=0.1)
    return policy.train()


def what_comes(policy, size=2):
    shape = (size, policy.config.tokens_per_slot * policy.config.latent_size)
    return {next_latent_key(slot): torch.randn(shape) for slot in policy.config.slots}


def step(policy, make_batch):
    batch = make_batch(policy, actions=True) | what_comes(policy)
    loss, facts = policy(batch)
    loss.backward()
    return facts


def without_gradient(policy):
    trained = {n: p for n, p in policy.named_parameters() if p.requires_grad and not n.endswith(BY_SYMMETRY)}
    assert trained
    return [n for n, p in trained.items() if p.grad is None or not bool(p.grad.abs().max() > 0)]


@pytest.mark.parametrize("site", ["prefix", "suffix"])
@pytest.mark.parametrize("gated", [False, True])
@pytest.mark.parametrize("option", OPTIONS)
def test_every_trained_weight_gets_a_gradient(option, gated, site, make_policy, make_batch):
    """Else data-parallel training without a search for unused parameters would stop at the second step."""
    settings = {"token_site": site, "start_at_base": gated, "action_objective": "flow", **OPTIONS[option]}
    policy = alive(make_policy(**settings))
    step(policy, make_batch)
    assert without_gradient(policy) == []
    frozen = {n for n, p in policy.named_parameters() if not p.requires_grad}
    assert any("vision_tower" in n for n in frozen) == (option in ("expert_only", "frozen_vision"))
    assert any("language_model.layers.0" in n for n in frozen) == (option == "expert_only")
    assert any("language_model.layers.1.mlp" in n for n in frozen)  # nobody reads the last layer's


def test_next_force_is_learnt_and_leaves_nothing_behind(make_policy, make_batch, tmp_path):
    policy = alive(make_policy(next_force_weight=0.5, token_site="suffix"))
    facts = step(policy, make_batch)
    assert 0.1 < facts["next_force_loss"] < 10
    batch = make_batch(policy, actions=True)
    with pytest.raises(ContractError, match="next_latent"):
        policy(batch)
    ended = {key: value * torch.nan for key, value in what_comes(policy).items()}
    _, facts = policy(batch | ended)
    assert facts["next_force_loss"] == 0.0  # the episode ends before: nothing to tell
    per_sample, _ = policy(batch | what_comes(policy), reduction="none")
    assert per_sample.shape == (2,)
    policy.eval()
    _, facts = policy(batch)  # scored on actions alone
    assert "next_force_loss" not in facts
    assert policy.predict_action_chunk(batch).isfinite().all()


def test_next_force_needs_latents(make_config):
    with pytest.raises(ContractError, match="next_force_weight"):
        make_config(next_force_weight=0.1, touch_input="wrench")


@pytest.mark.skipif(not HAS_PEFT, reason="peft isn't installed (an extra of LeRobot's)")
@pytest.mark.parametrize("site", ["prefix", "suffix"])
def test_lora_trains_its_targets_and_the_new_modules(site, make_policy, make_batch, tmp_path):
    start = make_policy(token_site=site, start_at_base=True, action_objective="flow")
    start.save_pretrained(tmp_path / "start")
    policy = PI05UniforcePolicy.from_pretrained(tmp_path / "start")
    policy.config.pretrained_path = tmp_path / "start"
    wrapped = alive(policy.wrap_with_peft(peft_cli_overrides={"method_type": "LORA", "r": 2}))
    for name, p in wrapped.named_parameters():
        if "lora_B" in name:  # starts as zeros: the other half would get no gradient
            torch.nn.init.normal_(p, std=0.1)
    loss, _ = wrapped(make_batch(policy, actions=True))
    loss.backward()
    assert without_gradient(wrapped) == []
    trained = {n for n, p in wrapped.named_parameters() if p.requires_grad}
    assert all("lora" in n or "modules_to_save" in n for n in trained)
    for part in ("force_tokens", "touch_gate", "time_mlp_in.lora", "mlp.gate_proj.lora"):
        assert any(part in n for n in trained), part
    policy.eval()
    batch, noise = make_batch(policy), torch.randn(2, 16, 8)
    with_adapters = policy.predict_action_chunk(batch, noise=noise)
    plain = wrapped.merge_and_unload().eval()
    assert plain.model.fast is not None
    assert torch.allclose(with_adapters, plain.predict_action_chunk(batch, noise=noise), atol=1e-4)


def test_lora_names_exist(make_policy):
    """Each target is there to be adapted, peft or not; LeRobot's own list names modules π0.5 lacks."""
    import re

    policy = make_policy(start_at_base=True)
    targets = policy._get_default_peft_targets()
    names = [n for n, m in policy.named_modules() if isinstance(m, torch.nn.Linear)]
    hit = [n for n in names if re.fullmatch(targets["target_modules"], n)]
    assert sum("gemma_expert" in n for n in hit) == 7 * policy.config.tiny_depth
    assert sum("language_model" in n for n in hit) == 2 * policy.config.tiny_depth - 1
    assert sum("_mlp_" in n or "action_" in n for n in hit) == 4
    assert {"force_tokens", "state_token", "touch_gate"} == set(targets["modules_to_save"])
    assert policy.config.output_features["action"].type == FeatureType.ACTION
