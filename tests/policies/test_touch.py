import json
from contextlib import nullcontext
from unittest import mock

import pytest
import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from policy_samples import OPEN, alive, calibrate, inputs, ours, start_noise, watched, with_dots

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, training
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config
from lerobot_policy_pi05_uniforce.touch.sensors import (
    load_calibrations,
    make_monitor,
    policy_sensors,
)
from lerobot_policy_pi05_uniforce.touch.tokens import SHUT, Felt, ForceTokens
from lerobot_policy_pi05_uniforce.touch.touch_input import TouchInput
from uniforce_vtla.errors import CheckpointError, ContractError, RolloutError, SensorError
from uniforce_vtla.keys import latent_key, tactile_key
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS, FreeAirError

PROJECTIONS = ("action_in_proj", "action_out_proj", "time_mlp_in", "time_mlp_out")
ONE, BOTH = {"touch0": "right"}, {"touch0": "right", "touch1": "left"}
KINDS = pytest.mark.parametrize("kind", ["latent", "newtons"])


class PlainNetwork(stock.PI05Pytorch):
    """LeRobot's own network around another network's modules."""

    def __init__(self, other):
        torch.nn.Module.__init__(self)
        self.config, self.rtc_processor = other.config, None
        self.gradient_checkpointing_enabled = False
        for name in ("paligemma_with_expert", *PROJECTIONS):
            setattr(self, name, getattr(other, name))


def test_no_touch_is_bit_equal_to_plain_pi05(make_policy, make_batch):
    policy = make_policy(sampler__kind="stock", touch__input="none")
    policy.model.state_token = None
    *seen, felt = inputs(policy, make_batch(policy))
    assert felt == Felt()
    plain, start = PlainNetwork(policy.model), start_noise(policy)
    ours = policy.model.sample_actions(*seen, felt, noise=start)
    assert torch.equal(ours, plain.sample_actions(*seen, noise=start))
    assert not any("force" in key or "tactile" in key for key in policy.state_dict())


def test_masked_touch_equals_no_touch(policy, batch):
    given, noise = inputs(policy, batch), start_noise(policy)
    touched = ours(policy, given, noise)
    without = ours(policy, given._replace(felt=Felt(given.felt.state)), noise)
    policy.touch.hidden.add("left")
    half = ours(policy, inputs(policy, batch), noise)
    policy.touch.hidden.add("right")
    masked = ours(policy, inputs(policy, batch), noise)
    assert torch.allclose(masked, without, atol=1e-6)
    for felt in (touched, half):
        assert (felt - without).abs().max() > 1e-3
    assert (touched - half).abs().max() > 1e-3


@pytest.mark.parametrize("gate", [None, OPEN])
def test_joint_training_velocity_equals_sampling_velocity(gate, make_policy, make_batch):
    policy = alive(make_policy(touch__start_at_base=gate is not None), gate)
    *seen, felt = inputs(policy, make_batch(policy))
    x, time = start_noise(policy), torch.tensor([0.7, 0.3])
    actions = torch.zeros_like(x)
    x_t = time[:, None, None] * x
    # (u − v)², u = x − 0
    squared = policy.model.forward(*seen, felt, actions=actions, noise=x, time=time)
    with policy.model.feeling(felt):
        prefix, pads, atts = policy.model.embed_prefix(*seen)
        mask = stock.prepare_attention_masks_4d(stock.make_att_2d_masks(pads, atts))
        joint, places = policy.model.paligemma_with_expert, torch.cumsum(pads, 1) - 1
        _, cache = joint.forward(mask, places, None, [prefix, None], use_cache=True)
        velocity = policy.model.denoise_step(pads, cache, x_t, time)
    assert torch.allclose(squared.sqrt(), (x - velocity).abs(), atol=1e-4)


def test_force_tokens_keep_amplitude(policy):
    tokens = policy.model.force_tokens
    touch = torch.randn(1, 16, 6)
    assert (tokens(touch, 0) - tokens(3 * touch, 0)).abs().mean() > 0.05
    assert torch.allclose(tokens(touch, 0).square().mean(-1), torch.ones(1, 16), atol=1e-3)


def test_a_token_of_tiny_also_holds_the_whole_map(make_config):
    tokens = ForceTokens(make_config(), (16, 6), 32)
    touch = torch.randn(1, 16, 6)
    elsewhere = touch.clone()
    elsewhere[:, 5] += 1
    moved = (tokens(touch, 0) - tokens(elsewhere, 0)).abs().sum(dim=-1)[0] > 0
    assert moved.all()
    assert ForceTokens(make_config(touch__input="wrench"), (1, 4), 32).whole is None
    assert ForceTokens(make_config(size="base"), (16, 6), 32).whole is None


def test_reference_is_encoded_once_until_reset(make_policy, make_batch):
    policy = make_policy(touch__slots=ONE)
    batch = make_batch(policy)
    encoder = policy.model.tactile_encoder.model.encoder
    real = encoder.encode_reference
    with mock.patch.object(encoder, "encode_reference", side_effect=real) as encoded:
        for _ in range(3):
            policy.felt(batch)
        assert encoded.call_count == 1
        policy.reset()
        policy.felt(batch)
        assert encoded.call_count == 2
        policy.felt({**batch, tactile_key("right", True): batch[tactile_key("left", True)]})
        assert encoded.call_count == 3


def test_lost_touch_is_an_error(policy, batch):
    nan = {**batch, latent_key("touch0"): torch.full((2, 96), torch.nan)}
    with pytest.raises(RolloutError, match="NaN"):
        policy.predict_action_chunk(nan)
    black = {**batch, tactile_key("left", True): batch[tactile_key("left")] * 0}
    with pytest.raises(ContractError, match="all black"):
        policy.predict_action_chunk(black)
    del batch[tactile_key("left")]
    with pytest.raises(RolloutError, match="tactile_left"):
        policy.predict_action_chunk(batch)


def test_lost_touch_can_be_masked_and_is_logged_once(make_policy, make_batch, caplog):
    policy = make_policy(touch__on_sensor_loss="mask")
    batch = make_batch(policy)
    del batch[tactile_key("left")]
    for _ in range(2):
        masks = policy.felt(batch).masks
    assert masks[0].all() and not masks[1].any()
    assert sum("tactile_left" in r.message for r in caplog.records) == 1


def test_an_unhealthy_sensor_is_logged_once_though_its_distance_changes(policy, caplog):
    policy.config.touch.on_sensor_loss = "mask"
    for distance in ("1.1", "1.2"):
        policy.touch._lost("touch0", SensorError(f"latents within 1.0, got {distance}"))
    assert caplog.text.count("going on without touch") == 1


def test_a_sensor_that_is_not_healthy_stops_the_rollout_at_the_third_look(policy, batch):
    watched(policy)
    for _ in range(2):  # episodes
        policy.reset()
        for _ in range(FREE_LOOKS - 1):
            policy.predict_action_chunk(batch)
        with pytest.raises(SensorError, match="tactip on the right finger"):
            policy.predict_action_chunk(batch)


@KINDS
def test_an_open_hand_in_free_air_takes_a_new_reference_once_an_episode(
    make_policy, make_batch, in_free_air, caplog, kind
):
    policy = make_policy(touch__input=kind)
    batch = make_batch(policy, size=1)
    in_free_air(policy, batch)
    odd = [policy.felt(batch).touches[0] for _ in range(FREE_LOOKS + 2)]
    assert torch.equal(odd[0], odd[FREE_LOOKS - 2]) and not torch.equal(odd[0], odd[FREE_LOOKS - 1])
    assert caplog.text.count("new reference") == 1
    policy.reset()  # the next episode begins with the reference it is given
    assert torch.equal(policy.felt(batch).touches[0], odd[0])
    policy.reset()
    policy.config.action.target_range[1][4] += 0.03  # the hand may hold something
    with pytest.raises(SensorError, match="in free air"):
        for _ in range(FREE_LOOKS):
            policy.felt(batch)


def test_a_sensor_that_is_not_healthy_can_be_masked_and_is_not_watched_in_training(
    make_policy, make_batch
):
    policy = watched(make_policy(touch__on_sensor_loss="mask"))
    batch = make_batch(policy)
    masks = [policy.felt(batch).masks for _ in range(FREE_LOOKS + 2)]
    assert masks[0][0].all()
    for mask in masks[FREE_LOOKS - 1 :]:  # and it stays so
        assert not mask[0].any() and mask[1].all()
    policy.reset()
    assert policy.felt(batch).masks[0].all()
    policy = watched(make_policy()).train()
    for _ in range(FREE_LOOKS + 1):
        policy.felt(batch)


def test_held_out_data_is_no_rollout_to_watch(policy, make_batch):
    watched(policy).eval()
    batch = make_batch(policy)
    for _ in range(FREE_LOOKS + 1):
        policy.forward(batch)


@pytest.mark.parametrize(("steps", "judged"), [(2, True), (10, True), (50, False)])
def test_free_air_is_judged_only_where_looks_come_before_the_grasp(steps, judged, shipped):
    shipped.right_sensor = "tactip"
    shipped.n_action_steps = steps
    monitor = make_monitor(shipped, "touch0", None)
    odd = monitor._healthy_range.mean.view(1, shipped.tokens_per_slot, shipped.latent_size) + 50.0
    with pytest.raises(FreeAirError if judged else SensorError) as raised:
        for _ in range(FREE_LOOKS):
            monitor.see(odd)
    assert isinstance(raised.value, FreeAirError) == judged


@pytest.mark.parametrize(
    ("slots", "asked", "hidden"),
    [(ONE, None, False), (ONE, 0.5, True), (BOTH, None, True), (BOTH, 0.0, False)],
)
def test_touch_dropout_in_training_with_two_slots_or_on_request(
    slots, asked, hidden, make_policy, make_batch
):
    policy = make_policy(touch__slots=slots, augment__touch_dropout=asked)
    batch = make_batch(policy, size=32)
    assert policy.felt(batch).masks.all()
    assert policy.train().felt(batch).masks.all() != hidden


def test_newtons_are_what_the_shipped_head_reads_in_the_latents(make_policy, make_batch):
    policy = make_policy(touch__input="newtons")
    latents = make_policy(touch__tokenizer_path=None)
    batch = with_dots(make_batch(policy))
    newtons = policy.felt(batch).touches
    read = latents.felt(batch).touches
    head = ForceHead.from_pretrained("tactip").model
    cached = {key: value for key, value in batch.items() if "tactile" not in key}
    for slot, force_N, z in zip(policy.config.slots, newtons, read, strict=True):
        torch.testing.assert_close(force_N[:, 0], head.step(z, None)[0])
        cached[latent_key(slot)] = z.flatten(1)
    torch.testing.assert_close(policy.felt(cached).touches, newtons)
    assert torch.equal(latents.felt(cached).touches, read)
    assert policy.model.force_tokens.input_scale.tolist() == [5.0, 5.0, 10.0]


@KINDS
def test_touch_acts_and_a_swap_mirrors_as_the_right_finger_did(make_policy, make_batch, kind):
    policy = make_policy(touch__input=kind, touch__slots=ONE)
    batch = with_dots(make_batch(policy))
    first = policy.predict_action_chunk(batch)
    other = {**batch, tactile_key("right"): batch[tactile_key("left")]}
    assert not torch.equal(first, policy.predict_action_chunk(other))
    # a left finger would have seen it so
    for reference in (True, False):
        batch[tactile_key("left", reference)] = batch[tactile_key("right", reference)].flip(-1)
    policy.config.swap = "touch0:left"
    sensors = policy_sensors(policy.config, policy.model.tactile_encoder)
    policy.touch = TouchInput(policy.config, sensors)
    torch.testing.assert_close(policy.predict_action_chunk(batch), first)


# stated in docs/design.md: what shut touch may move an action, in network units of order 1
AT_START = 1e-5


@pytest.mark.parametrize("kind", ["fast", "stock"])
def test_the_first_action_is_the_bases(kind, make_policy, make_batch):
    settings = {"touch__input": "wrench", "sampler__kind": kind}
    policy = alive(make_policy(touch__start_at_base=True, **settings))
    given, noise = inputs(policy, make_batch(policy, size=3)), start_noise(policy, 3)
    # touch isn't appended
    without = ours(policy, given._replace(felt=Felt(given.felt.state)), noise)
    assert (ours(policy, given, noise) - without).abs().max() <= AT_START
    alive(policy, gate=OPEN)
    assert (ours(policy, given, noise) - without).abs().max() > 1e-3
    policy.model.touch_gate = None  # the same weights, appended plainly
    assert (ours(policy, given, noise) - without).abs().max() > 100 * AT_START


def test_the_gate_has_a_gradient_from_the_first_step(make_policy, make_batch):
    policy = alive(make_policy(touch__start_at_base=True)).train()
    policy(make_batch(policy))[0].backward()
    shut = policy.model.touch_gate.gate.grad
    others = policy.model.action_in_proj.weight.grad.abs().max()
    # of a size an optimiser sees, though the gate is at 1e-6
    assert shut.abs().min() > 1e-4 * others


def test_a_short_training_opens_the_gate_where_touch_decides_the_action(
    make_policy, make_batch, monkeypatch
):
    """The action is the wrench's first number: without touch the loss can't fall below its
    variance."""
    monkeypatch.setattr(training, "GATE_LR", 1e-2)
    touch = {"touch__input": "wrench", "touch__slots": ONE, "touch__start_at_base": True}
    policy = make_policy(action__form="absolute", **touch).train()
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    batch = make_batch(policy, size=16)
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


def test_the_gate_and_what_starts_random_learn_at_their_own_rates(make_policy):
    policy = make_policy(touch__start_at_base=True)
    groups = policy.get_optim_params()
    assert [group.get("lr") for group in groups] == [None, 1e-3, training.GATE_LR]
    assert len(groups[2]["params"]) == 1 and len(groups[1]["params"]) > 5
    trained = {id(p) for group in groups for p in group["params"]}
    assert trained == {id(p) for p in policy.parameters() if p.requires_grad}


@pytest.fixture
def shipped():
    """The shipped policy's settings."""
    return stored_config(shipped_checkpoint())


def test_a_finger_is_calibrated_at_rollout_and_no_checkpoint_names_a_calibration(
    policy, batch, tmp_path
):
    folder = calibrate(tmp_path / "map", policy.config, shift=0.5)
    policy.save_pretrained(tmp_path / "policy")
    config = PI05UniforceConfig.from_pretrained(
        tmp_path / "policy", cli_overrides=[f"--right_calibration={folder}"]
    )
    calibrated = PI05UniforcePolicy.from_pretrained(tmp_path / "policy", config=config)
    right, left = calibrated.felt(batch).touches - policy.felt(batch).touches
    assert torch.allclose(right, torch.tensor(0.5), atol=1e-6) and not left.any()
    calibrated.save_pretrained(tmp_path / "again")
    stored = json.loads((tmp_path / "again" / "config.json").read_text())
    assert stored["right_calibration"] == ""
    calibrate(tmp_path / "map", policy.config, tokenizer_hash="another")
    with pytest.raises(CheckpointError, match="Calibrate again"):
        PI05UniforcePolicy.from_pretrained(tmp_path / "policy", config=config)


def test_a_checkpoint_with_a_gate_is_not_loaded_without_one(make_policy, tmp_path):
    policy = make_policy(touch__start_at_base=True)
    policy.save_pretrained(tmp_path)
    config = PI05UniforceConfig.from_pretrained(tmp_path)
    config.touch.start_at_base = False
    with pytest.raises(CheckpointError, match=r"touch_gate\.gate"):
        PI05UniforcePolicy.from_pretrained(tmp_path, config=config)


@pytest.mark.parametrize(("anchor", "judged"), [("tactip:1", "after"), ("gelsight:1", "before")])
def test_a_calibrated_sensor_is_watched_as_the_one_that_it_was_calibrated_to(
    tmp_path, shipped, anchor, judged
):
    shipped.right_sensor = "tactip"
    # the map turns healthy latents into odd ones
    shipped.right_calibration = calibrate(tmp_path, shipped, shift=50.0, anchor=anchor)
    monitor = make_monitor(shipped, "touch0", load_calibrations(shipped)["right"])
    healthy = monitor._healthy_range.mean.view(1, shipped.tokens_per_slot, shipped.latent_size)
    with pytest.raises(FreeAirError) if judged == "after" else nullcontext():
        for _ in range(FREE_LOOKS):
            monitor.see(healthy)


def test_a_calibration_of_another_kind_is_refused(tmp_path, shipped):
    shipped.right_sensor = "tactip"
    shipped.right_calibration = calibrate(tmp_path, shipped, new="uskin:2")
    says = "right_calibration: expected one of a tactip, got one of uskin:2"
    with pytest.raises(CheckpointError, match=says):
        load_calibrations(shipped)


@pytest.fixture
def watch_start(make_controller):
    """Let the shipped policy begin in a scene whose right finger wears this; return what it
    watches."""

    def begin(words, monitor="stop"):
        env = WipeEnv("touch", right_sensor=words)
        controller = make_controller(monitor=monitor)
        observation, _ = env.reset(seed=20_000)
        controller.reset(env)
        for _ in range(2 * FREE_LOOKS):
            for action in controller.chunk(observation, env.task):
                env.advance(action)
            observation = env.observe()
        return controller.policy.touch.sensors["touch0"].monitor is not None

    return begin


def test_the_shipped_policy_renews_a_shifted_reference_and_stops_on_markers_that_come_and_go(
    watch_start, caplog
):
    assert watch_start("tactip:1") and "new reference" not in caplog.text
    watch_start("tactip:1+shift=1")
    assert "new reference" in caplog.text
    with pytest.raises(SensorError, match="in free air"):
        watch_start("tactip:1+flicker=0.6")
    assert not watch_start("tactip:1+flicker=0.6", monitor="off")
