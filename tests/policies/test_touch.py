import json
import logging
from collections import deque
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from policy_samples import (
    OPEN,
    alive,
    calibrate,
    inputs,
    ours,
    start_noise,
    watched,
    with_dots,
)

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, training
from lerobot_policy_pi05_uniforce.checkpoint import check_settings
from lerobot_policy_pi05_uniforce.controller import (
    PolicyController,
    shipped_checkpoint,
    stored_config,
)
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.touch.sensors import (
    PolicySensors,
    load_calibrations,
    make_monitor,
)
from lerobot_policy_pi05_uniforce.touch.tokens import SHUT, Felt, ForceTokens
from lerobot_policy_pi05_uniforce.touch.touch_input import TouchInput, marker_images
from uniforce_vtla.errors import CheckpointError, ContractError, RolloutError, SensorError
from uniforce_vtla.keys import latent_key, tactile_key
from uniforce_vtla.tokenizer.finger_balance import FingerBalance
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent_range import (
    FREE_LOOKS,
    FreeAirError,
)

PROJECTIONS = ("action_in_proj", "action_out_proj", "time_mlp_in", "time_mlp_out")


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


def test_masked_touch_equals_no_touch(make_policy, make_batch):
    policy = make_policy()
    *seen, felt = inputs(policy, make_batch(policy))
    start = start_noise(policy)
    off = replace(felt, masks=torch.zeros_like(felt.masks))
    masked = policy.model.sample_actions(*seen, off, noise=start)
    without = policy.model.sample_actions(*seen, Felt(felt.state), noise=start)
    touched = policy.model.sample_actions(*seen, felt, noise=start)
    assert torch.allclose(masked, without, atol=1e-6)
    assert (touched - without).abs().max() > 1e-3


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


def test_force_tokens_keep_amplitude(make_policy):
    tokens = make_policy().model.force_tokens
    touch = torch.randn(1, 16, 6)
    assert (tokens(touch, 0) - tokens(3 * touch, 0)).abs().mean() > 0.05
    assert torch.allclose(tokens(touch, 0).square().mean(-1), torch.ones(1, 16), atol=1e-3)


@pytest.mark.parametrize("settings", [{}, {"touch__input": "wrench"}, {"size": "base"}])
def test_a_token_of_tiny_also_holds_the_whole_map(settings, make_config):
    config = make_config(**{**settings, "tiny__width": 64})
    shape = (16, 6) if config.touch.input == "latent" else (1, 4)
    tokens = ForceTokens(config, shape, 32)
    assert (tokens.whole is not None) == (not settings)
    if tokens.whole is not None:
        touch = torch.randn(1, 16, 6)
        elsewhere = touch.clone()
        elsewhere[:, 5] += 1
        moved = (tokens(touch, 0) - tokens(elsewhere, 0)).abs().sum(dim=-1)[0] > 0
        assert moved.all()


def test_cached_latents_equal_encoding_the_images(make_policy, make_batch):
    policy = make_policy()
    batch = make_batch(policy)
    touches = policy.felt(batch).touches
    cached = {k: v for k, v in batch.items() if "tactile" not in k}
    cached |= {
        latent_key(slot): touches[i].flatten(1) for i, slot in enumerate(("touch0", "touch1"))
    }
    again = policy.felt(cached).touches
    assert torch.equal(touches, again)


def test_reference_is_encoded_once_until_reset(make_policy, make_batch, monkeypatch):
    policy = make_policy(touch__slots={"touch0": "right"})
    batch, calls = make_batch(policy), []
    encoder = policy.model.tactile_encoder.model.encoder
    real = encoder.encode_reference
    monkeypatch.setattr(encoder, "encode_reference", lambda x: calls.append(1) or real(x))
    for _ in range(3):
        policy.felt(batch)
    assert len(calls) == 1
    policy.reset()
    policy.felt(batch)
    assert len(calls) == 2
    policy.felt({**batch, tactile_key("right", True): batch[tactile_key("left", True)]})
    assert len(calls) == 3


def test_lost_touch_is_an_error(make_policy, make_batch):
    policy = make_policy()
    batch = make_batch(policy)
    gone = {k: v for k, v in batch.items() if k != tactile_key("left")}
    with pytest.raises(RolloutError, match="tactile_left"):
        policy.predict_action_chunk(gone)
    nan = {**batch, "observation.latent.touch0": torch.full((2, 96), torch.nan)}
    with pytest.raises(RolloutError, match="NaN"):
        policy.predict_action_chunk(nan)
    with pytest.raises(ContractError, match="all black"):
        policy.predict_action_chunk(
            {**batch, tactile_key("left", True): batch[tactile_key("left")] * 0}
        )


def test_lost_touch_can_be_masked_and_is_logged_once(make_policy, make_batch, caplog):
    policy = make_policy(touch__on_sensor_loss="mask")
    batch = make_batch(policy)
    gone = {k: v for k, v in batch.items() if k != tactile_key("left")}
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            masks = policy.felt(gone).masks
    assert masks[0].all() and not masks[1].any()
    assert sum("tactile_left" in r.message for r in caplog.records) == 1


def test_a_sensor_that_is_not_healthy_stops_the_rollout_at_the_third_look(make_policy, make_batch):
    policy = watched(make_policy())
    batch = make_batch(policy)
    for _ in range(2):  # episodes
        policy.reset()
        for _ in range(FREE_LOOKS - 1):
            policy.predict_action_chunk(batch)
        with pytest.raises(SensorError, match="tactip on the right finger"):
            policy.predict_action_chunk(batch)


@pytest.mark.parametrize("kind", ["latent", "newtons"])
def test_an_open_hand_in_free_air_takes_a_new_reference_once_an_episode(
    make_policy, make_batch, caplog, kind
):
    policy = make_policy(touch__input=kind)
    batch = make_batch(policy, size=1)
    current = marker_images(batch, "right")[1]
    sensor = watched(policy).touch.sensors["touch0"]
    sensor.monitor._usual.mean = sensor.raw_latent(current, current)[0].flatten()
    open_m = batch[MEASURED_STATE][0, 4].item()
    policy.config.action.target_range = [[0.0] * 5, [0.0] * 4 + [open_m]]
    odd = [policy.touch.gather(batch, training=False)[0][0] for _ in range(FREE_LOOKS + 2)]
    assert torch.equal(odd[0], odd[FREE_LOOKS - 2]) and not torch.equal(odd[0], odd[FREE_LOOKS - 1])
    assert sum("new reference" in record.message for record in caplog.records) == 1
    policy.reset()  # the next episode begins with the reference it is given
    assert torch.equal(policy.touch.gather(batch, training=False)[0][0], odd[0])
    policy.reset()
    # the hand may hold something
    policy.config.action.target_range = [[0.0] * 5, [0.0] * 4 + [open_m + 0.03]]
    with pytest.raises(SensorError, match="in free air"):
        for _ in range(FREE_LOOKS):
            policy.touch.gather(batch, training=False)


def tensors_in(thing, seen):
    """Every tensor that can be reached from an object of ours, by name."""
    if id(thing) in seen:
        return
    seen[id(thing)] = thing
    if isinstance(thing, torch.Tensor):
        yield thing
        return
    ours = type(thing).__module__.startswith(("lerobot_policy", "uniforce_vtla"))
    parts = list(vars(thing).values()) if ours or isinstance(thing, torch.nn.Module) else []
    if isinstance(thing, dict):
        parts += thing.values()
    if isinstance(thing, list | tuple | deque):
        parts += thing
    for part in parts:
        yield from tensors_in(part, seen)


@pytest.mark.parametrize("kind", ["latent", "newtons"])
def test_whatever_touch_holds_follows_the_policy_to_its_device(
    kind, make_policy, make_batch, tmp_path
):
    """No module registers ranges, maps and references: on a GPU the first look failed."""
    one = {"touch__input": kind, "touch__slots": {"touch0": "right"}}
    folder = calibrate(tmp_path, make_policy(**one).config)
    policy = make_policy(**one, right_calibration=folder)
    sensor = watched(policy, 99.0).touch.sensors["touch0"]
    latent_map = sensor.calibration.map
    sensor.monitor._worn = latent_map
    policy.select_action(make_batch(policy, size=1))
    policy.to("meta")
    elsewhere = [t for t in tensors_in(policy.touch, {}) if t.device.type != "meta"]
    assert not elsewhere and latent_map.weight.device.type == "meta"
    assert not [t for t in tensors_in(policy.issued, {}) if t.device.type != "meta"]


def test_a_sensor_that_is_not_healthy_can_be_masked_and_is_not_watched_in_training(
    make_policy, make_batch
):
    policy = watched(make_policy(touch__on_sensor_loss="mask"))
    batch = make_batch(policy)
    masks = [policy.felt(batch).masks for _ in range(FREE_LOOKS)]
    assert masks[0][0].all() and not masks[-1][0].any() and masks[-1][1].all()
    policy = watched(make_policy(touch__on_sensor_loss="error")).train()
    for _ in range(FREE_LOOKS + 1):
        policy.felt(batch)


def test_touch_dropout_in_training_with_two_slots_or_on_request(make_policy, make_batch):
    one, two = {"touch0": "right"}, {"touch0": "right", "touch1": "left"}
    for slots, asked, hidden in (
        (one, None, False),
        (one, 0.5, True),
        (two, None, True),
        (two, 0.0, False),
    ):
        policy = make_policy(touch__slots=slots, augment__touch_dropout=asked)
        batch = make_batch(policy, size=32)
        policy.train()
        masks = policy.felt(batch).masks
        assert (not masks.all()) == hidden
        policy.eval()
        masks = policy.felt(batch).masks
        assert masks.all()


def test_newtons_are_what_the_shipped_head_reads_in_the_latents(
    make_policy, make_batch, tokenizer_path
):
    with pytest.raises(CheckpointError, match="packaged"):
        # the tests' own tokenizer has no head
        make_policy(touch__input="newtons", touch__tokenizer_path=str(tokenizer_path))
    policy = make_policy(touch__input="newtons")
    latents = make_policy(touch__tokenizer_path=None)
    batch = with_dots(make_batch(policy))
    newtons, _ = policy.touch.gather(batch, training=False)
    read, _ = latents.touch.gather(batch, training=False)
    head = ForceHead.from_pretrained("tactip").model
    for force, z in zip(newtons, read, strict=True):
        torch.testing.assert_close(force[:, 0], head.step(z, None)[0])
    cached = {key: value for key, value in batch.items() if "tactile" not in key}
    cached |= {
        latent_key(slot): z.flatten(1) for slot, z in zip(policy.config.slots, read, strict=True)
    }
    stored, _ = policy.touch.gather(cached, training=False)
    torch.testing.assert_close(stored, newtons)
    assert policy.model.force_tokens.input_scale.tolist() == [5.0, 5.0, 10.0]


@pytest.mark.parametrize("kind", ["latent", "newtons"])
def test_touch_acts_and_a_swap_mirrors_as_the_right_finger_did(make_policy, make_batch, kind):
    one = {"touch__input": kind, "touch__slots": {"touch0": "right"}}
    policy = make_policy(**one, sampler__noise_scale=0.0)
    batch = with_dots(make_batch(policy))
    first = policy.predict_action_chunk(batch)
    other = {**batch, tactile_key("right"): batch[tactile_key("left")]}
    assert not torch.equal(first, policy.predict_action_chunk(other))
    # a left finger would have seen it so
    flipped = {
        tactile_key("left", r): batch[tactile_key("right", r)].flip(-1) for r in (True, False)
    }
    policy.config.swap = "touch0:left"
    policy.touch = TouchInput(
        policy.config, PolicySensors(policy.config, policy.model.tactile_encoder)
    )
    torch.testing.assert_close(policy.predict_action_chunk({**batch, **flipped}), first)


def test_a_masked_policy_acts_without_touch(make_policy, make_batch):
    policy = make_policy(sampler__noise_scale=0.0)
    batch = make_batch(policy)
    touched = policy.predict_action_chunk(batch)
    policy.touch.masked = True
    other = {**batch, tactile_key("right"): batch[tactile_key("left")]}
    muted = policy.predict_action_chunk(batch)
    torch.testing.assert_close(muted, policy.predict_action_chunk(other))
    assert not torch.equal(muted, touched)


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
    loss, _ = policy(make_batch(policy, actions=True))
    loss.backward()
    shut = policy.model.touch_gate.gate.grad
    others = policy.model.action_in_proj.weight.grad.abs().max()
    # of a size an optimiser sees, though the gate is at 1e-6
    assert shut.abs().min() > 1e-4 * others


def test_a_short_training_opens_the_gate_where_touch_decides_the_action(
    make_policy, make_batch, monkeypatch
):
    """The action is the wrench's first number: without touch the loss can't fall below its variance."""
    monkeypatch.setattr(training, "GATE_LR", 1e-2)
    one = {"touch__slots": {"touch0": "right"}, "action__form": "absolute"}
    policy = make_policy(touch__input="wrench", touch__start_at_base=True, **one).train()
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


@pytest.fixture
def shipped():
    """The shipped policy's settings."""
    return stored_config(shipped_checkpoint())


def test_a_finger_is_calibrated_at_rollout_and_no_checkpoint_names_a_calibration(
    make_policy, make_batch, tmp_path
):
    policy = make_policy()
    batch = make_batch(policy)
    before = policy.touch.gather(batch, training=False)[0][0]
    folder = calibrate(tmp_path / "map", policy.config, shift=0.5)
    finger = policy.config.finger_by_slot()["touch0"]
    policy.save_pretrained(tmp_path / "policy")
    config = PI05UniforceConfig.from_pretrained(
        tmp_path / "policy", cli_overrides=[f"--{finger}_calibration={folder}"]
    )
    calibrated = PI05UniforcePolicy.from_pretrained(tmp_path / "policy", config=config)
    after = calibrated.touch.gather(batch, training=False)[0][0]
    assert torch.allclose(after, before + 0.5, atol=1e-6)
    calibrated.save_pretrained(tmp_path / "again")
    stored = json.loads((tmp_path / "again" / "config.json").read_text())
    assert stored[f"{finger}_calibration"] == ""
    with pytest.raises(CheckpointError, match="Only who loads"):
        check_settings(stored | {f"{finger}_calibration": "/elsewhere"}, "config.json")
    calibrate(tmp_path / "map", policy.config, tokenizer_hash="another")
    with pytest.raises(CheckpointError, match="Calibrate again"):
        PI05UniforcePolicy.from_pretrained(tmp_path / "policy", config=config)


def test_a_policy_that_feels_no_latents_takes_no_calibration(make_policy, tmp_path):
    with pytest.raises(ContractError, match="latents to map"):
        make_policy(touch__input="wrench", left_calibration=str(tmp_path))


@pytest.mark.parametrize(("anchor", "judged"), [("tactip:1", "after"), ("gelsight:1", "before")])
def test_a_calibrated_sensor_is_watched_as_the_one_that_it_was_calibrated_to(
    tmp_path, shipped, anchor, judged
):
    shipped.right_sensor = "tactip"
    # the map turns healthy latents into odd ones
    shipped.right_calibration = calibrate(tmp_path, shipped, shift=50.0, anchor=anchor)
    monitor = make_monitor(shipped, "touch0", load_calibrations(shipped)["right"])
    healthy = monitor._usual.mean.view(1, shipped.tokens_per_slot, shipped.latent_size)
    with pytest.raises(FreeAirError) if judged == "after" else nullcontext():
        for _ in range(FREE_LOOKS):
            monitor.see(healthy)


def test_a_calibration_of_another_type_of_sensor_is_refused(tmp_path, shipped):
    shipped.right_sensor = "gelsight"
    shipped.right_calibration = calibrate(tmp_path, shipped, new="uskin:2", anchor="tactip:1")
    with pytest.raises(CheckpointError, match="one of a gelsight, got one of uskin:2"):
        load_calibrations(shipped)


def test_newtons_are_scaled_by_the_gain_that_known_loads_gave(tmp_path, shipped):
    read = {}
    folder = calibrate(tmp_path / "gain", shipped, gain=2.0)
    for calibration in ("", folder):
        config = stored_config(shipped_checkpoint())
        config.right_sensor = "tactip"
        config.right_calibration = calibration
        policy = PI05UniforcePolicy.from_pretrained(shipped_checkpoint(), config=config)
        env = WipeEnv("touch", right_sensor="tactip:7", drawn=("right",))
        env.reset(seed=20_000)
        batch = {}
        for reference, image in zip((True, False), env.marker_pair("right"), strict=True):
            batch[tactile_key("right", reference)] = torch.from_numpy(image)[None] / 255.0
        read[calibration] = policy.touch.read(batch, "touch0")
    assert read[folder].shape == (1, 1, 3) and torch.allclose(read[folder], 2 * read[""])
    shipped.right_calibration = calibrate(tmp_path, shipped, gain=2.0, head_hash="another")
    wanted = "right_calibration: expected a gain of newtons that head"
    with pytest.raises(CheckpointError, match=wanted):
        load_calibrations(shipped)
    shipped.touch.input = "latent"
    with pytest.raises(CheckpointError, match="this policy feels no newtons"):
        load_calibrations(shipped)


def watch_start(words, monitor="stop", drawn=("right",)):
    """Let the shipped policy begin in a scene whose right finger wears this; return what it watches."""
    env = WipeEnv("touch", right_sensor=words, drawn=drawn)
    kinds = {"left": "gelsight", "right": "tactip"}
    controller = PolicyController(shipped_checkpoint(), kinds, monitor=monitor)
    observation, _ = env.reset(seed=20_000)
    controller.reset(env)
    for _ in range(2 * FREE_LOOKS):
        for action in controller.chunk(observation, env.task):
            env.advance(action)
        observation = env.observe()
    return controller.policy.touch.is_watched


def test_the_shipped_policy_renews_a_shifted_reference_and_stops_on_markers_that_come_and_go(
    caplog,
):
    assert watch_start("tactip:1") and "new reference" not in caplog.text
    watch_start("tactip:1+shift=1")
    assert "new reference" in caplog.text
    with pytest.raises(SensorError, match="in free air"):
        watch_start("tactip:1+flicker=0.6")
    assert not watch_start("tactip:1+flicker=0.6", monitor="off")


def test_the_shipped_policy_compares_its_finger_with_the_other_one_where_that_is_seen(
    caplog, monkeypatch
):
    grips_N = []
    monkeypatch.setattr(
        FingerBalance, "see", lambda self, own_N, other_N: grips_N.append((own_N, other_N)) or 2.0
    )
    watch_start("tactip:1")
    assert not grips_N
    watch_start("tactip:1", drawn=("left", "right"))
    assert len(grips_N) == 2 and np.abs(grips_N).max() < 1  # the hand is open
    assert "right finger reads 2.00 times the other one's grip" in caplog.text
    watch_start("tactip:1", monitor="off", drawn=("left", "right"))
    assert len(grips_N) == 2
