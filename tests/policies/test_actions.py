import copy
import json
import math
import sys
from contextlib import nullcontext
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.rollout.inference.rtc import supports_rtc_inference
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors as make_processors
from lerobot_policy_pi05_uniforce.action import (
    STRIDE,
    CheckActionStep,
    NetworkUnits,
    on_leash,
    to_deltas,
    to_targets,
)
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import made_up_batch
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import (
    MEASURED_STATE,
    SPAN_FLOOR,
    floor_quantiles,
)
from uniforce_vtla.errors import ContractError, RolloutError
from uniforce_vtla.keys import ACTION

SCALE = [0.004, 0.02, 0.01, 0.05, 0.003]  # the default delta_scale
UNITS = NetworkUnits(SCALE)
BENT = NetworkUnits(SCALE, [0, 0, 0.003, 0, 0.0003])
LEASH = torch.tensor([0.02, 0.02, 0.02, 0.2, 0.03])  # the default
AHEAD = torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0])  # y, on and on
FAR = torch.tensor([[0.5, 0.0, 5.0, 0.0, 0.04]])  # of the demos


@pytest.fixture
def policy(make_policy):
    return make_policy(touch__input="none")


@given(
    seed=st.integers(0, 10_000),
    size=st.integers(1, 4),
    steps=st.integers(1, 8),
    units=st.sampled_from([UNITS, BENT]),
)
def test_deltas_and_targets_are_inverse(seed, size, steps, units):
    actions = torch.rand(size, 1 + steps, 5, generator=torch.Generator().manual_seed(seed))
    deltas = to_deltas(actions, None, torch.zeros(size, 5), units)
    assert torch.allclose(to_targets(deltas, actions[:, 0], units), actions[:, 1:], atol=1e-6)


def test_an_episode_starts_from_the_measured_state_as_a_rollout_does():
    actions, measured = torch.rand(2, 4, 5), torch.rand(2, 5)
    is_pad = torch.tensor([[True, False, False, False], [False] * 4])
    deltas = to_deltas(actions, is_pad, measured, UNITS)
    assert torch.allclose(to_targets(deltas, measured, UNITS)[0], actions[0, 1:], atol=1e-6)
    assert torch.allclose(to_targets(deltas, actions[:, 0], UNITS)[1], actions[1, 1:], atol=1e-6)


def fixed_deltas(policy, deltas):
    """Let the network answer fixed deltas, (B or 1, steps or 1, 5) in network units."""

    def sample(images, masks, tokens, text_mask, **kwargs):
        out = torch.zeros(len(tokens), policy.config.chunk_size, policy.config.max_action_dim)
        out[:, :, :5] = deltas
        return out

    policy.model.sample_actions = sample


def test_chunks_continue_from_the_last_command_of_each_row(make_policy, make_batch):
    policy = make_policy(touch__input="none", n_action_steps=2)
    rows = torch.tensor([[0.1] * 5, [-0.2] * 5])
    fixed_deltas(policy, rows[:, None])
    first = make_batch(policy)
    policy.reset()
    _, second = [policy.select_action(first) for _ in range(2)]
    move = rows * policy.network_units.unit[1]  # of the second step
    assert torch.allclose(second, first[MEASURED_STATE] + move, atol=1e-6)
    elsewhere = make_batch(policy)
    # the measured state moved, within the leash: it must not matter any more
    elsewhere[MEASURED_STATE] = first[MEASURED_STATE] + 0.01 * torch.rand(2, 5)
    assert torch.allclose(policy.select_action(elsewhere), second + move / 2, atol=1e-6)
    policy.select_action(elsewhere)
    policy.reset()
    anew = elsewhere[MEASURED_STATE] + move / 2
    assert torch.allclose(policy.select_action(elsewhere), anew, atol=1e-6)


@pytest.mark.parametrize("known", [True, False])
def test_targets_stay_within_what_demos_commanded(known, make_config, make_batch, stats, tmp_path):
    """Changes add up: a hand that had risen out of the demos went on rising."""
    high = torch.tensor(stats[ACTION]["max"], dtype=torch.float32)
    policy = PI05UniforcePolicy(make_config(), dataset_stats=stats if known else None)
    policy.save_pretrained(tmp_path)
    policy = PI05UniforcePolicy.from_pretrained(tmp_path)
    fixed_deltas(policy, 9.0)
    policy.issued.record(high.expand(2, 5))
    top = policy.predict_action_chunk(make_batch(policy)).amax(dim=(0, 1))
    assert torch.allclose(top, high) == known
    assert bool((top > high + 1e-3).any()) != known


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("target_range", [[0.0] * 5]),
        ("target_range", [[0.0] * 4, [1.0] * 4]),
        ("target_range", [[0.0] * 5, [1.0] * 4 + [-1.0]]),
        ("delta_knee", [0.001]),
        ("delta_knee", [0, 0, -0.001, 0, 0]),
        ("delta_scale", [0.1, 0.1]),
        ("leash", [0.02] * 4),
        ("leash", [0.0, 0.02, 0.02, 0.2, 0.03]),
        ("leash", [math.inf] * 5),
    ],
)
def test_numbers_that_do_not_fit_the_axes_are_refused(name, value, make_policy):
    with pytest.raises(ContractError, match=name):
        make_policy(touch__input="none", **{f"action__{name}": value})


def test_postprocessor_leaves_targets_in_si_units(policy, batch, stats):
    _, after = make_processors(policy.config, stats)
    action = policy.select_action(batch)
    assert torch.equal(after(action), action)


def test_absolute_actions_are_normalised_by_lerobot(make_policy, stats):
    policy = make_policy(touch__input="none", action__form="absolute")
    assert policy.config.action_delta_indices == list(range(16))
    _, after = make_processors(policy.config, stats)
    low = after(-torch.ones(1, 5))
    assert np.allclose(low.numpy()[0], stats["action"]["q01"], atol=1e-6)


def test_the_network_never_sees_the_last_command(policy, batch):
    policy.train()
    moved = {**batch, "action": batch["action"] + 0.5}  # same deltas, another absolute place
    losses = []
    for b in (batch, moved):
        torch.manual_seed(3)
        losses.append(policy.forward(b)[0])
    assert torch.allclose(*losses, rtol=1e-4)


@pytest.mark.parametrize("reduction", ["mean", "none"])
def test_padded_steps_and_axes_give_no_loss(policy, batch, reduction):
    batch["action_is_pad"][:, 5:] = True  # the last command and four steps are real
    losses = torch.full((2, 16, 8), 1e6)
    losses[:, :4, :5] = 2.0
    policy.model.forward = lambda *args, **flow: losses
    loss, _ = policy.forward(batch, reduction=reduction)
    assert torch.allclose(loss, torch.tensor(2.0))
    assert loss.shape == (() if reduction == "mean" else (2,))


def test_a_batch_without_the_measured_state_is_refused(policy, batch):
    del batch[MEASURED_STATE]
    with pytest.raises(ContractError, match="preprocessor"):
        policy.select_action(batch)


def test_beyond_the_knee_a_move_is_its_logarithm():
    small, large = torch.full((1, 5), 1e-5), torch.full((1, 5), 0.04)
    assert torch.allclose(BENT.to_network(small)[0, 4], torch.tensor(1e-5 / 3e-4), rtol=1e-3)
    logarithm = (2 * large[:, [2, 4]] / BENT.unit[:, [2, 4]]).log()
    assert torch.allclose(BENT.to_network(large)[:, [2, 4]], logarithm, atol=0.01)
    assert torch.equal(BENT.to_network(large)[:, [0, 1, 3]], UNITS.to_network(large)[:, [0, 1, 3]])


def test_a_steady_motion_is_the_same_number_at_every_step_of_a_chunk():
    """In units of one size the last of 16 steps weighed 256 times as much as the first in a squared
    error."""
    units = NetworkUnits([0.004] * 5, chunk=16)
    steady = 0.001 * torch.arange(1, 17)[:, None].expand(16, 5)
    assert torch.allclose(units.to_network(steady), torch.full((16, 5), 2.0))
    assert torch.allclose(units.to_si(units.to_network(steady)), steady)
    assert torch.allclose(units.unit[7], torch.tensor(0.004))  # half a chunk: as the setting says


@given(
    low=st.lists(st.floats(-1, 1), min_size=5, max_size=5),
    span=st.lists(st.floats(0, 0.2), min_size=5, max_size=5),
)
def test_quantile_spans_are_floored(low, span):
    low, span = np.array(low), np.array(span)
    stat = {"q01": low, "q99": low + span}
    floored = floor_quantiles({"observation.state": stat, "other": stat})
    assert floored["other"] is stat
    low_end, high_end = floored["observation.state"]["q01"], floored["observation.state"]["q99"]
    assert np.allclose(high_end - low_end, np.maximum(span, SPAN_FLOOR), atol=1e-9)
    assert np.allclose(low_end + high_end, 2 * low + span)


def test_a_policy_leaves_the_callers_statistics_alone(make_config, stats):
    low, high = stats["observation.state"]["q01"], stats["observation.state"]["q99"].copy()
    high[3] = low[3]  # demos that never turned the hand
    still = stats | {"observation.state": {"q01": low, "q99": high}}
    before = copy.deepcopy(still)
    meta = SimpleNamespace(stats=still, root="")
    PI05UniforcePolicy(make_config(touch__input="none"), dataset_stats=still, dataset_meta=meta)
    np.testing.assert_equal(still, before)
    # where LeRobot's trainer takes a stored normaliser's from
    state = meta.stats["observation.state"]
    assert np.allclose((state["q99"] - state["q01"])[3], SPAN_FLOOR[3])


def test_local_text_tokenizer_round_trips(make_config, stats):
    before, _ = make_processors(make_config(), stats)
    state = torch.tensor([0.5, 0.0, 0.1, 0.0, 0.04])
    batch = before({"observation.state": state, "task": "wipe the züge_off"})
    tokens, mask = batch[OBS_LANGUAGE_TOKENS], batch[OBS_LANGUAGE_ATTENTION_MASK]
    assert tokens.shape == (1, 64) and mask.sum() < 40
    step = next(s for s in before.steps if hasattr(s, "input_tokenizer"))
    text = step.input_tokenizer.decode(tokens[0][mask[0]][1:])
    assert text == "Task: wipe the züge off, State: 128 128 85 128 128;\nAction: "


def test_a_cut_prompt_is_said(make_config, stats, caplog):
    before, _ = make_processors(make_config(), stats)
    before({"observation.state": torch.tensor([0.5, 0.0, 0.1, 0.0, 0.04]), "task": "x" * 100})
    assert "may be cut" in caplog.text


def test_larger_camera_frames_shrink_as_training_views_do(policy, batch):
    batch["observation.images.front"] = large = torch.rand(2, 3, 112, 112)
    images, _ = policy._preprocess_images(batch)
    wanted = large.unflatten(3, (28, 4)).unflatten(2, (28, 4)).mean((3, 5))
    assert torch.allclose(images[0], 2 * wanted - 1, atol=1e-6)


def test_regression_trains_the_very_actions_it_samples(policy, batch):
    """Its loss is the squared error of the chunk that one step from zero noise gives."""
    assert policy.config.action.objective == "regression"
    assert policy.config.num_inference_steps == 1
    chunk = policy.predict_action_chunk(batch)  # absolute targets, from the measured state on
    said = (chunk - batch[MEASURED_STATE][:, None]) / policy.network_units.unit
    wanted = policy.prepare_action(batch)[..., :5]
    loss, _ = policy.forward(batch)
    torch.testing.assert_close(loss, (said - wanted).square().mean(), rtol=1e-4, atol=0)
    assert torch.equal(policy.forward(batch)[0], loss)  # nothing random is left in it
    noise = torch.randn(len(chunk), policy.config.chunk_size, policy.config.max_action_dim)
    assert torch.equal(policy.predict_action_chunk(batch, noise=noise), chunk)


def test_evaluation_mode_reaches_a_module_that_was_set_apart(policy):
    modules = list(policy.modules())
    policy.eval()
    assert not any(module.training for module in modules)
    modules[-1].train()  # set by hand: asking again mends it
    policy.eval()
    assert not modules[-1].training
    policy.train()
    assert policy.training and policy.model.training


STEP = CheckActionStep(low=[0.0, -1.0], high=[1.0, 1.0], margin=0.5)


@given(st.lists(st.tuples(st.floats(-0.49, 1.49), st.floats(-1.99, 1.99)), min_size=1, max_size=4))
def test_what_is_near_the_demos_passes(rows):
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
def test_what_is_not_stops(row, says):
    with pytest.raises(RolloutError, match=says):
        STEP.action(torch.tensor([[0.5, 0.0], row]))


@pytest.mark.parametrize("form", ["absolute", "target_delta"])
def test_the_check_travels_with_the_policy(form, make_config, stats, tmp_path):
    _, after = make_processors(make_config(action__form=form), stats)
    after.save_pretrained(tmp_path)
    saved = json.loads((tmp_path / "policy_postprocessor.json").read_text())["steps"][-1]
    assert saved["registry_name"] == "uniforce_check_action"
    # LeRobot's rollout takes no options for a stored step: moves are checked in the policy, where
    # stop_outside_demos can be given
    high = list(stats["action"]["max"]) if form == "absolute" else []
    assert saved["config"]["high"] == pytest.approx(high)


def test_an_axis_the_demos_never_moved_has_some_room():
    still = CheckActionStep(low=[0.2], high=[0.2])
    assert torch.equal(still.action(torch.tensor([[0.24]])), torch.tensor([[0.24]]))
    with pytest.raises(RolloutError):
        still.action(torch.tensor([[0.26]]))


# setting, whether LeRobot's rollout runs → whether an action outside the demos stops. A bool is of
# older checkpoints
@pytest.mark.parametrize(
    ("stop", "on_robot", "stops"),
    [
        ("robot", True, True),
        ("robot", False, False),
        ("always", False, True),
        ("never", True, False),
        (False, True, True),
        (False, False, False),
        (True, False, True),
    ],
)
@pytest.mark.parametrize("form", ["absolute", "target_delta"])
def test_outside_the_demos_a_robot_stops_and_a_poor_policy_in_a_scene_is_scored(
    stop, on_robot, stops, form, make_policy, make_batch, stats, monkeypatch
):
    if on_robot:
        monkeypatch.setitem(sys.modules, "lerobot.rollout", SimpleNamespace())
    else:
        monkeypatch.delitem(sys.modules, "lerobot.rollout", raising=False)
    bounds = [list(stats["action"][name]) for name in ("min", "max")]
    more = {"action__target_range": bounds, "action__stop_outside_demos": stop}
    policy = make_policy(touch__input="none", action__form=form, **more)
    _, after = make_processors(policy.config, stats)
    batch = make_batch(policy, size=1) | {MEASURED_STATE: FAR}
    with pytest.raises(RolloutError, match="axis 2") if stops else nullcontext():
        after(FAR if form == "absolute" else policy.select_action(batch))
    with pytest.raises(RolloutError, match="finite"):
        after(torch.full((1, 5), torch.nan))


def test_the_first_target_is_led_and_a_later_leap_issues_nothing(make_policy, make_batch):
    policy = make_policy(touch__input="none", n_action_steps=3)
    deltas = torch.zeros(1, policy.config.chunk_size, 5)
    growth = policy.network_units.unit[:3, 0] / policy.delta_scale[0]
    # of delta_scale, from the chunk's base
    deltas[0, :3, 0] = torch.tensor([99.0, 108.0, 119.0]) / growth
    fixed_deltas(policy, deltas)
    batch = make_batch(policy)
    first, second = [policy.select_action(batch) for _ in range(2)]
    assert torch.equal(first, batch[MEASURED_STATE] + LEASH * torch.tensor([1, 0, 0, 0, 0]))
    with pytest.raises(RolloutError, match="change of target, axis 0"):
        policy.select_action(batch)
    assert torch.equal(policy.issued.last, second)


@given(
    lead=st.lists(st.floats(-0.5, 0.5), min_size=5, max_size=5),
    at_rad=st.floats(-math.pi, math.pi),
    steps=st.integers(0, 20),
)
def test_a_target_leads_no_farther_than_its_leash_and_within_it_is_what_it_was(lead, at_rad, steps):
    measured = torch.tensor([[0.5, 0.0, 0.1, at_rad, 0.04]])
    target = measured + torch.tensor([lead])
    # beyond half a turn: the other way round
    target[0, 3] = math.remainder(float(target[0, 3]), 2 * math.pi)
    led = on_leash(target, measured, LEASH, steps)
    longest = LEASH * (1 + STRIDE * steps) + 1e-5
    ahead = led - measured
    ahead[0, 3] = math.remainder(float(ahead[0, 3]), 2 * math.pi)
    assert (ahead.abs() <= longest).all()
    inside = torch.tensor([lead]).abs() < longest - 2e-5
    assert torch.equal(led[inside], target[inside])


@pytest.mark.parametrize("steps", [1, 2, 6, 16])
def test_the_target_of_a_blocked_arm_does_not_run_away_and_goes_on_at_once_when_it_is_free(
    steps, make_policy, make_batch
):
    policy = make_policy(touch__input="none", n_action_steps=steps)
    fixed_deltas(policy, AHEAD)
    batch = make_batch(policy, size=1)
    for _ in range(200):
        blocked = policy.select_action(batch)
        assert ((blocked - batch[MEASURED_STATE]).abs() <= LEASH + 1e-6).all()
    batch[MEASURED_STATE] = batch[MEASURED_STATE] + 0.01 * AHEAD
    assert 0 < (policy.select_action(batch) - blocked)[0, 1] < 0.0101


def test_the_controllers_chunks_stay_on_the_leash_of_a_blocked_arm(make_controller):
    controller = make_controller()
    controller.policy.touch.sensors["touch0"].monitor = None
    fixed_deltas(controller.policy, AHEAD)
    at = torch.tensor([[0.5, 0.0, 0.05, 0.0, 0.04]])
    batch = made_up_batch(controller.config, torch.device("cpu")) | {MEASURED_STATE: at}
    later = STRIDE * (controller.config.n_action_steps - 1)  # of a look the last action
    for _ in range(100):
        lead = np.abs(controller._issue(batch) - at.numpy())
        assert (lead[0] <= LEASH.numpy() + 1e-6).all()
        assert (lead <= LEASH.numpy() * (1 + later) + 1e-6).all()


def test_real_time_chunking_is_refused_where_actions_are_deltas(policy, batch, make_policy):
    rtc = RTCConfig(enabled=True)
    assert not policy.supports_rtc() and not supports_rtc_inference(policy)
    with pytest.raises(ContractError, match=r"inference\.type=sync"):
        make_policy(touch__input="none", rtc_config=rtc)
    for given_by_lerobot in ({"prev_chunk_left_over": None}, {"inference_delay": 0}):
        with pytest.raises(ContractError, match="real-time chunking"):
            policy.predict_action_chunk(batch, **given_by_lerobot)
    policy.config.rtc_config = rtc  # as lerobot-rollout sets it on a loaded policy
    for call in (policy.init_rtc_processor, lambda: policy.predict_action_chunk(batch)):
        with pytest.raises(ContractError, match=r"inference\.type=sync"):
            call()
    free = make_policy(touch__input="none", action__form="absolute", rtc_config=rtc)
    assert free.supports_rtc()
    rtc.mode = "trained"  # of LeRobot's main
    with pytest.raises(ContractError, match=r"rtc_config\.mode: expected guided, got trained"):
        free.init_rtc_processor()


def test_a_loaded_policy_has_answered_before_a_robot_is_connected(policy, tmp_path, monkeypatch):
    """A slow first inference would look like a dead arm."""
    policy.save_pretrained(tmp_path)
    sample = mock.Mock(return_value=torch.zeros(1, 16, 8))
    monkeypatch.setattr(PI05UniforcePytorch, "sample_actions", sample)
    torch.manual_seed(5)
    policy = PI05UniforcePolicy.from_pretrained(tmp_path)
    state = torch.random.get_rng_state()
    assert sample.called and policy.issued.last is None and not policy._action_queue
    torch.manual_seed(5)
    sample.reset_mock()
    PI05UniforcePolicy.from_pretrained(tmp_path, dataset_stats=None)  # to be trained
    assert not sample.called and torch.equal(torch.random.get_rng_state(), state)


@pytest.mark.parametrize("kind", ["latent", "newtons", "wrench", "none"])
@pytest.mark.parametrize("slots", [{"touch0": "right"}, {"touch0": "right", "touch1": "left"}])
def test_every_kind_of_policy_is_warmed_up(kind, slots, make_policy):
    policy = make_policy(touch__input=kind, touch__slots=slots)
    policy.warm_up()
    assert policy.issued.last is None


# an environment's clock so fast that no call is in time, or so slow that every call is
@pytest.mark.parametrize(("hz", "missed"), [(1e6, 1), (1e-3, 0)])
def test_the_controller_holds_itself_to_the_environments_rate(hz, missed, make_controller):
    controller = make_controller()
    controller._batch = lambda observation, task: {}
    controller._issue = lambda batch: "a chunk"
    controller.reset(SimpleNamespace(metadata={"render_fps": hz}))
    assert controller.facts() == {"missed_deadlines": 0}
    assert controller.chunk({}, "wipe") == "a chunk"
    assert controller.facts() == {"missed_deadlines": missed}
