"""The fast sampler against LeRobot's own loop: same weights, same noise, same actions.

The functions that CUDA graphs would replay run uncaptured on the CPU. Nothing here proves that a
GPU can capture them; the last test does, where there is one.
"""

import functools
from dataclasses import replace

import pytest
import torch
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from policy_samples import OPEN, alive, inputs, lerobots_own, ours, start_noise

from lerobot_policy_pi05_uniforce.cuda_graphs import KEPT, Recordings
from lerobot_policy_pi05_uniforce.sampler import fast, layers
from lerobot_policy_pi05_uniforce.sampler.fast import BUCKETS, FastSampler, bucketed, velocity
from lerobot_policy_pi05_uniforce.sampler.prefix import drop_dead, encode

TOLERANCE = 1e-4  # on actions in network units, of order 1
# stated in docs/design.md; measured 2e-3 at π0.5's depth, where bfloat16 itself errs by 8e-3
BFLOAT16 = 5e-3
GATED = pytest.mark.parametrize("gate", [None, OPEN])


def gated_policy(make_policy, gate, **settings):
    touch = {"touch__input": "wrench", "touch__start_at_base": gate is not None}
    return alive(make_policy(**touch, **settings), gate)


def acts_alike(policy, given, steps=4):
    """Return our actions, which are those of LeRobot's loop from the same noise."""
    noise = start_noise(policy, len(given.tokens))
    fast = ours(policy, given, noise, steps)
    assert (lerobots_own(policy, given, noise, steps) - fast).abs().max() < TOLERANCE
    return fast


@pytest.fixture
def policy(make_policy):
    """A policy with touch behind a half-open gate, whose norms do something, and uncaptured
    graphs."""
    policy = gated_policy(make_policy, OPEN)
    policy.model.fast.recordings = Recordings(capture=False)
    return policy


@pytest.fixture
def given(policy, batch):
    return inputs(policy, batch)


@pytest.mark.parametrize("touch", ["none", "latent", "wrench"])
@pytest.mark.parametrize("steps", [1, 10])
def test_equals_the_stock_loop(touch, steps, make_policy, make_batch):
    policy = alive(make_policy(touch__input=touch))
    given, noise = inputs(policy, make_batch(policy, size=3)), start_noise(policy, 3)
    slow = lerobots_own(policy, given, noise, steps)
    assert (slow - noise).abs().max() > 0.05  # the network moves the noise at all
    assert (slow - ours(policy, given, noise, steps)).abs().max() < TOLERANCE


def lost(felt, rows):
    """Return what is felt where the last slot's sensor is lost in some rows of the batch."""
    masks = felt.masks.clone()
    masks[-1] &= rows
    return replace(felt, masks=masks)


@GATED
@pytest.mark.parametrize("size", [1, 3])
def test_rows_with_other_prompts_and_a_lost_finger_stay_apart(size, gate, make_policy, make_batch):
    policy = gated_policy(make_policy, gate)
    given = inputs(policy, make_batch(policy, size=size))
    if size > 1:
        shorter = given.masks.clone()
        shorter[1, 12:] = False
        felt = lost(given.felt, torch.tensor([True, True, False]))
        given = given._replace(masks=shorter, felt=felt)
    acts_alike(policy, given)


@pytest.mark.parametrize("graphs", [False, True])
def test_changed_weights_are_noticed(graphs, make_policy, make_batch):
    policy = alive(make_policy(touch__input="none"))
    if graphs:
        policy.model.fast.recordings = Recordings(capture=False)
    given = inputs(policy, make_batch(policy))
    acts_alike(policy, given)
    with torch.no_grad():
        for p in policy.model.paligemma_with_expert.gemma_expert.parameters():
            p.mul_(1.3)  # as an optimiser or load_state_dict does
    acts_alike(policy, given)


@GATED
def test_real_time_chunking_guides_both_alike(gate, make_policy, make_batch):
    """RTC differentiates through the velocity towards what is left of the chunk before."""
    rtc = RTCConfig(enabled=True, execution_horizon=4)
    policy = gated_policy(make_policy, gate, rtc_config=rtc, action__form="absolute")
    given, noise = inputs(policy, make_batch(policy)), start_noise(policy)
    free = ours(policy, given, noise)
    left = {"prev_chunk_left_over": free[:, 2:] + 0.5, "inference_delay": 1, "execution_horizon": 4}
    fast = ours(policy, given, noise, **left)
    assert (fast - free).abs().max() > 0.01  # it was guided at all
    assert (lerobots_own(policy, given, noise, **left) - fast).abs().max() < TOLERANCE


@GATED
def test_in_bfloat16_it_is_as_near_to_float32_as_lerobots_loop(gate, make_policy, make_batch):
    policy = gated_policy(make_policy, gate)
    given, noise = inputs(policy, make_batch(policy)), start_noise(policy)
    exact = lerobots_own(policy, given, noise, 10)
    policy.model.paligemma_with_expert.to_bfloat16_for_selected_params("bfloat16")  # as size base
    slow, fast = lerobots_own(policy, given, noise, 10), ours(policy, given, noise, 10)
    assert (slow - exact).abs().max() > 1e-5  # it was bfloat16
    assert (fast - slow).abs().max() < BFLOAT16
    assert (fast - exact).square().mean() < 1.5 * (slow - exact).square().mean()


@torch.no_grad()
def test_torch_compile_traces_step_and_prefix_whole(make_policy, make_batch):
    policy = gated_policy(make_policy, OPEN)
    network, prepared = policy.model, policy.model.fast.prepared
    given, noise = drop_dead(inputs(policy, make_batch(policy))), start_noise(policy)
    tables = prepared.tables(2)
    prefix = encode(network, prepared, given, noise.shape[1], always_mask=True)
    traced = [
        torch._dynamo.explain(encode)(network, prepared, given, 16, always_mask=True),
        torch._dynamo.explain(velocity)(network, prepared, prefix, noise, tables[0]),
    ]
    assert [found.graph_break_count for found in traced] == [0, 0], traced


def test_compiled_code_gives_lerobots_actions(policy, make_batch, caplog):
    """As traced and made functional for a compiler; inductor itself takes two minutes on a CPU."""
    sampler = policy.model.fast
    sampler._compiled = functools.cache(
        functools.partial(torch.compile, dynamic=False, backend="aot_eager")
    )
    sampler.compiles = True
    for _ in range(2):
        acts_alike(policy, inputs(policy, make_batch(policy)))
    assert sampler.compiles and len(sampler.recordings.kept) == 1
    assert not [r for r in caplog.records if r.name == fast.__name__]


@pytest.mark.thorough
def test_without_a_compiler_one_line_says_so_and_the_actions_are_the_same(
    policy, given, monkeypatch, tmp_path, caplog
):
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(torch._inductor.config.cpp, "cxx", ("/no/such/compiler",))
    torch._dynamo.reset()
    policy.model.fast.compiles = True
    for steps in (2, 3):
        acts_alike(policy, given, steps)
    (said,) = [r.message for r in caplog.records if r.name == fast.__name__]
    assert "compile" in said and "\n" not in said


@torch.no_grad()
@pytest.mark.parametrize("masked", [False, True])
def test_attention_by_folded_heads_is_torchs(masked):
    q, cache = torch.randn(2, 8, 50, 16), torch.randn(2, 2, 300, 16)
    mask = None
    if masked:
        mask = torch.zeros(2, 1, 1, 300).masked_fill(torch.rand(2, 1, 1, 300) > 0.7, -torch.inf)
    wanted = layers.attend(q, cache, mask)
    found = layers.attend_folded(q, cache, mask)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5)


@torch.no_grad()
def test_cameras_are_encoded_in_the_policys_dtype(make_policy):
    """LeRobot keeps SigLIP in float32; a copy in bfloat16 follows its weights."""
    policy = make_policy(touch__input="none")
    prepared, backbone = policy.model.fast.prepared, policy.model.paligemma_with_expert
    prepared.tables(1)
    assert prepared.tower is backbone.paligemma.model.vision_tower  # nothing is held twice
    backbone.to_bfloat16_for_selected_params("bfloat16")
    for factor in (1.0, 2.0):
        backbone.paligemma.model.multi_modal_projector.linear.weight.mul_(factor)
        prepared.tables(1)
        weight = backbone.paligemma.model.multi_modal_projector.linear.weight
        assert weight.dtype == torch.float32
        assert prepared.projector.linear.weight.dtype == torch.bfloat16
        torch.testing.assert_close(prepared.projector.linear.weight, weight.bfloat16())


def test_replays_give_lerobots_actions_for_every_new_observation(policy, make_batch):
    returned = []
    for _ in range(3):
        chunk = acts_alike(policy, inputs(policy, make_batch(policy)))
        returned.append((chunk, chunk.clone()))
    assert len(policy.model.fast.recordings.kept) == 1  # recorded once
    assert all(torch.equal(now, then) for now, then in returned)  # a later call overwrites no chunk


def test_prompts_cameras_and_lost_fingers_change_and_the_actions_are_still_lerobots(policy, given):
    shorter = given.masks.clone()
    shorter[:, 9:] = False
    gone = [torch.zeros_like(given.img_masks[0]), *given.img_masks[1:]]
    for changed in (
        given,
        given._replace(masks=shorter),
        given._replace(felt=lost(given.felt, torch.tensor([True, False]))),
        given._replace(img_masks=gone),
        given,
    ):
        acts_alike(policy, changed)
    # with and without the camera; the rest are values
    assert len(policy.model.fast.recordings.kept) == 2


def test_recordings_are_not_kept_for_ever(policy, given):
    for steps in range(1, KEPT + 3):
        ours(policy, given, start_noise(policy), steps)
    assert len(policy.model.fast.recordings.kept) == KEPT


def test_nothing_recorded_waits_for_the_device(policy, given):
    """A value read by the host, or a shape that depends on values, can't be captured."""
    ours(policy, given, start_noise(policy))
    (recording,) = policy.model.fast.recordings.kept.values()
    with torch.no_grad(), torch.profiler.profile() as profile:
        recording(recording.buffers)
    names = {event.name.removeprefix("aten::") for event in profile.events()}
    assert "scaled_dot_product_attention" in names
    waits = {"_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "equal", "_unique2"}
    assert not waits & names


def test_prompts_go_to_the_next_bucket():
    tokens, mask = torch.ones(2, 50, dtype=torch.long), torch.ones(2, 50, dtype=torch.bool)
    longer, padded = bucketed(tokens, mask)
    assert longer.shape == padded.shape == (2, 96) and int(padded.sum()) == 100
    assert bucketed(tokens.repeat(1, 5), mask.repeat(1, 5))[0].shape[1] == 250 > BUCKETS[-1]


@pytest.mark.parametrize(("kind", "made"), [("fast", True), ("eager", False)])
def test_graphs_are_for_cuda_alone_and_can_be_turned_off(kind, made, make_policy, make_batch):
    policy = make_policy(sampler__kind=kind)
    policy.predict_action_chunk(make_batch(policy))
    assert policy.model.fast.recordings is None  # a CPU
    assert policy.model.fast.is_graphed_on(torch.device("cuda")) == made


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device: capture was never run")
def test_a_gpu_captures_them(make_policy, make_batch):
    policy = make_policy(touch__input="wrench", touch__start_at_base=True).to("cuda")
    batch = {
        k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in make_batch(policy).items()
    }
    given, noise = inputs(policy, batch), start_noise(policy).cuda()
    for _ in range(2):
        fast = ours(policy, given, noise)
    assert policy.model.fast.recordings is not None
    assert (lerobots_own(policy, given, noise) - fast).abs().max() < 1e-3


def test_warm_up_records_each_length_of_text_and_compiles_the_usual_one(
    make_policy, monkeypatch, capsys
):
    compiled = []
    monkeypatch.setattr(torch, "compile", lambda f, **_: compiled.append(f.__name__) or f)
    monkeypatch.setattr(FastSampler, "is_graphed_on", lambda self, device: True)
    monkeypatch.setattr(fast, "Recordings", functools.partial(Recordings, capture=False))
    policy = make_policy(touch__input="none", tokenizer_max_length=BUCKETS[-1])
    policy.warm_up()
    assert compiled == ["encode", "velocity"] and not policy.model.fast.compiles
    assert len(policy.model.fast.recordings.kept) == len(BUCKETS)
    assert "compiling" in capsys.readouterr().err  # the bar


def test_cameras_may_come_as_bytes(make_policy, make_batch):
    policy = make_policy(touch__input="none")
    batch = make_batch(policy)
    sent, as_floats = dict(batch), dict(batch)
    for key in policy.config.image_features:
        sent[key] = (255 * batch[key]).round().to(torch.uint8)
        as_floats[key] = sent[key].float() / 255
    images, wanted = (torch.stack(policy._preprocess_images(b)[0]) for b in (sent, as_floats))
    assert torch.equal(images, wanted)
