"""Actions that can't be meant stop the rollout; all others pass untouched."""

from __future__ import annotations

import json

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors
from lerobot_policy_pi05_uniforce.check_action import CheckActionStep, check_leap
from uniforce_vtla.errors import RolloutError

STEP = CheckActionStep(low=[0.0, -1.0], high=[1.0, 1.0], margin=0.5)


@given(st.lists(st.tuples(st.floats(-0.49, 1.49), st.floats(-1.99, 1.99)), min_size=1, max_size=4))
def test_what_is_near_the_demos_passes(rows) -> None:
    action = torch.tensor(rows)
    assert torch.equal(STEP.action(action), action)
    assert torch.equal(STEP.action(action[None]), action[None])  # a chunk


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ([float("nan"), 0.0], "finite"),
        ([0.0, float("inf")], "finite"),
        ([1.6, 0.0], "axis 0"),
        ([0.5, -2.1], "axis 1"),
    ],
)
def test_what_is_not_stops(row, says) -> None:
    with pytest.raises(RolloutError, match=says):
        STEP.action(torch.tensor([[0.5, 0.0], row]))


def test_without_statistics_only_finite_is_asked() -> None:
    free = CheckActionStep.of(None)
    assert torch.equal(free.action(torch.full((1, 2), 1e6)), torch.full((1, 2), 1e6))
    with pytest.raises(RolloutError):
        free.action(torch.full((1, 2), float("nan")))


def test_the_check_travels_with_the_policy(make_config, stats, tmp_path) -> None:
    _, after = make_pi05_uniforce_pre_post_processors(make_config(stop_outside_demos=True), stats)
    after.save_pretrained(tmp_path)
    saved = json.loads((tmp_path / "policy_postprocessor.json").read_text())["steps"][-1]
    assert saved["registry_name"] == "uniforce_check_action"
    assert saved["config"]["high"] == pytest.approx(list(stats["action"]["max"]))
    with pytest.raises(RolloutError, match="axis 2"):
        after(torch.tensor([[0.5, 0.0, 5.0, 0.0, 0.04]]))


def test_an_axis_the_demos_never_moved_has_some_room() -> None:
    still = CheckActionStep(low=[0.2], high=[0.2])
    assert torch.equal(still.action(torch.tensor([[0.24]])), torch.tensor([[0.24]]))
    with pytest.raises(RolloutError):
        still.action(torch.tensor([[0.26]]))


def test_unless_asked_a_poor_policy_is_scored_not_stopped(make_config, stats) -> None:
    _, after = make_pi05_uniforce_pre_post_processors(make_config(), stats)
    after(torch.tensor([[0.5, 0.0, 5.0, 0.0, 0.04]]))
    with pytest.raises(RolloutError, match="finite"):
        after(torch.tensor([[0.5, 0.0, float("nan"), 0.0, 0.04]]))


def test_a_leap_stops_and_the_first_target_never_does() -> None:
    scale = torch.tensor([0.01, 0.1])
    last = torch.tensor([[0.5, 0.0]])
    check_leap(torch.tensor([[9.0, 9.0]]), None, scale)
    check_leap(torch.tensor([[0.59, -0.9]]), last, scale)
    with pytest.raises(RolloutError, match="axis 0"):
        check_leap(torch.tensor([[0.61, 0.0]]), last, scale)


def test_a_policy_that_leaps_issues_nothing(make_policy, make_batch, monkeypatch) -> None:
    policy = make_policy(touch_input="none", n_action_steps=2)

    def sample(images, masks, tokens, text_mask, **kwargs):
        out = torch.zeros(len(tokens), policy.config.chunk_size, policy.config.max_action_dim)
        out[:, 1, 0] = 11.0  # of delta_scale
        return out

    monkeypatch.setattr(policy.model, "sample_actions", sample)
    batch = make_batch(policy)
    first = policy.select_action(batch)
    with pytest.raises(RolloutError, match="change of target"):
        policy.select_action(batch)
    assert torch.equal(policy.issued.last, first)
