"""The fast sampler against LeRobot's own loop: same weights, same noise, same actions.

The functions that CUDA graphs would replay run uncaptured on the CPU. Nothing here proves that a GPU can capture them;
the last test does, where there is one.
"""

import timeit
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from policy_samples import OPEN, alive, inputs, lerobots_own, ours, start_noise
from torch import nn
from torch.nn import functional as F  # noqa: N812
from torch.utils._python_dispatch import TorchDispatchMode

from lerobot_policy_pi05_uniforce.sampler import layers
from lerobot_policy_pi05_uniforce.sampler.cuda_graphs import BUCKETS, KEPT, GraphedSampler, bucketed
from lerobot_policy_pi05_uniforce.sampler.prefix import drop_dead
from uniforce_vtla.errors import ContractError

TOLERANCE = 1e-4  # on actions in network units, of order 1
# stated in docs/design.md; measured 2e-3 at π0.5's depth, where bfloat16 itself errs by 8e-3
BFLOAT16 = 5e-3
GATED = pytest.mark.parametrize("gate", [None, OPEN])


def gated_policy(make_policy, gate, **settings):
    settings = {"touch__input": "wrench", **settings}
    return alive(make_policy(touch__start_at_base=gate is not None, **settings), gate)


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
    given, noise = inputs(policy, make_batch(policy, size=size)), start_noise(policy, size)
    if size > 1:
        shorter = given.masks.clone()
        shorter[1, 12:] = False
        given = given._replace(
            masks=shorter, felt=lost(given.felt, torch.tensor([True, True, False]))
        )
    assert (lerobots_own(policy, given, noise) - ours(policy, given, noise)).abs().max() < TOLERANCE


@pytest.mark.parametrize("graphs", [False, True])
def test_changed_weights_are_noticed(graphs, make_policy, make_batch):
    policy = alive(make_policy(touch__input="none"))
    if graphs:
        policy.model.fast.graphed = GraphedSampler(policy.model.fast, capture=False)
    given, noise = inputs(policy, make_batch(policy)), start_noise(policy)
    ours(policy, given, noise)
    with torch.no_grad():
        for p in policy.model.paligemma_with_expert.gemma_expert.parameters():
            p.mul_(1.3)  # as an optimiser or load_state_dict does
    assert (lerobots_own(policy, given, noise) - ours(policy, given, noise)).abs().max() < TOLERANCE


@GATED
def test_real_time_chunking_guides_both_alike(gate, make_policy, make_batch):
    """RTC differentiates through the velocity towards what is left of the chunk before."""
    rtc = RTCConfig(enabled=True, execution_horizon=4)
    policy = gated_policy(make_policy, gate, rtc_config=rtc, action__form="absolute")
    given, noise = inputs(policy, make_batch(policy)), start_noise(policy)
    free = ours(policy, given, noise)
    left = {
        "prev_chunk_left_over": free[:, 2:, :] + 0.5,
        "inference_delay": 1,
        "execution_horizon": 4,
    }
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


@pytest.mark.slow  # dynamo traces for some seconds
@torch.no_grad()
def test_torch_compile_traces_step_and_prefix_whole(make_policy, make_batch):
    policy = gated_policy(make_policy, OPEN)
    fast, given = policy.model.fast, drop_dead(inputs(policy, make_batch(policy)))
    tables, noise = fast.prepared.tables(2), start_noise(policy)
    prefix = fast.encoder.encode(given, noise.shape[1])
    step = torch._dynamo.explain(fast.velocity)(prefix, noise, tables[0])
    prefill = torch._dynamo.explain(fast.encoder.prefill)(given, 48, always_mask=True)
    reasons = step.break_reasons, prefill.break_reasons
    assert (step.graph_break_count, prefill.graph_break_count) == (0, 0), reasons


CLOSE = {"rtol": 1e-5, "atol": 1e-5}


@torch.no_grad()
def test_products_and_their_epilogues_are_torchs() -> None:
    x, w, b, other = (
        torch.randn(2, 7, 24),
        torch.randn(16, 24) / 5,
        torch.randn(16),
        torch.randn(2, 7, 16),
    )
    plain = F.linear(x, w)
    torch.testing.assert_close(layers.linear(x, w, b), plain + b, **CLOSE)
    torch.testing.assert_close(
        layers.linear_gelu(x, w, b), F.gelu(plain + b, approximate="tanh"), **CLOSE
    )
    torch.testing.assert_close(layers.linear_times(x, w, other), plain * other, **CLOSE)
    torch.testing.assert_close(layers.linear_plus(x, w, b, other), plain + b + other, **CLOSE)


@torch.no_grad()
@pytest.mark.parametrize("rows", [0, 1, 50])
def test_attention_in_one_product_is_torchs(rows: int) -> None:
    q, cache = torch.randn(1, 8, 50, 16), torch.randn(1, 2, 300, 16)
    mask = None if rows == 0 else torch.rand(1, 1, rows, 300) > 0.3
    k, v = (cache[:, n : n + 1].expand(-1, 8, -1, -1) for n in (0, 1))
    wanted = F.scaled_dot_product_attention(q, k, v, attn_mask=mask, scale=1.0)
    torch.testing.assert_close(
        layers.attend_one(q, cache[0, 0], cache[0, 1], mask), wanted, **CLOSE
    )


def test_where_a_gradient_is_wanted_torch_runs() -> None:
    x, w = torch.randn(3, 8), torch.randn(4, 8, requires_grad=True)
    assert not layers.here(x)
    layers.linear_gelu(x, w).sum().backward()
    assert w.grad is not None and bool(w.grad.abs().max() > 0)
    with torch.no_grad():
        assert not layers.here(x.bfloat16()) and layers.here(x) == layers.AVAILABLE


@torch.no_grad()
def test_cameras_are_seen_as_transformers_sees_them(make_policy) -> None:
    model = make_policy(touch__input="none").model.paligemma_with_expert
    for norm in (m for m in model.modules() if isinstance(m, nn.LayerNorm)):
        nn.init.normal_(norm.weight), nn.init.normal_(norm.bias)
    images = torch.rand(3, 3, 28, 28) * 2 - 1
    wanted = model.embed_image(images)
    assert wanted.abs().max() > 0.01
    torch.testing.assert_close(layers.embed_cameras(model.paligemma.model, images), wanted, **CLOSE)


@pytest.fixture
def policy(make_policy):
    """A policy with touch behind a half-open gate, whose norms do something, and uncaptured graphs."""
    policy = alive(make_policy(touch__input="wrench", touch__start_at_base=True), OPEN)
    policy.model.fast.graphed = GraphedSampler(policy.model.fast, capture=False)
    return policy


def both(policy, given, steps=4):
    noise = start_noise(policy, len(given.tokens))
    return lerobots_own(policy, given, noise, steps), ours(policy, given, noise, steps)


def test_replays_give_lerobots_actions_for_every_new_observation(policy, make_batch):
    graphed = policy.model.fast.graphed
    returned = []
    for _ in range(3):
        slow, fast = both(policy, inputs(policy, make_batch(policy)))
        assert (slow - fast).abs().max() < TOLERANCE
        returned.append((fast, fast.clone()))
    assert len(graphed._pairs) == 1  # recorded once
    assert all(torch.equal(now, then) for now, then in returned)  # a later call overwrites no chunk


def test_prompts_cameras_and_lost_fingers_change_and_the_actions_are_still_lerobots(
    policy, make_batch
):
    whole = inputs(policy, make_batch(policy))
    shorter = whole.masks.clone()
    shorter[:, 9:] = False
    gone = [torch.zeros_like(whole.img_masks[0]), *whole.img_masks[1:]]
    for given in (
        whole,
        whole._replace(masks=shorter),
        whole._replace(felt=lost(whole.felt, torch.tensor([True, False]))),
        whole._replace(img_masks=gone),
        whole,
    ):
        slow, fast = both(policy, given)
        assert (slow - fast).abs().max() < TOLERANCE
    # with and without the camera; the rest are values
    assert len(policy.model.fast.graphed._pairs) == 2


def test_pairs_are_not_kept_for_ever(policy, make_batch):
    given = inputs(policy, make_batch(policy))
    for steps in range(1, KEPT + 3):
        both(policy, given, steps)
    assert len(policy.model.fast.graphed._pairs) == KEPT


def recorded_pair(policy):
    """The only pair of graphs after one call."""
    (pair,) = policy.model.fast.graphed._pairs.values()
    return pair


class Recorded(TorchDispatchMode):
    def __init__(self):
        super().__init__()
        self.names = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.names.add(func._schema.name.split("::")[1])
        return func(*args, **(kwargs or {}))


def test_nothing_recorded_waits_for_the_device(policy, make_batch):
    """A value read by the host, or a shape that depends on values, can't be captured."""
    given = inputs(policy, make_batch(policy))
    both(policy, given)
    pair = recorded_pair(policy)
    with torch.no_grad(), Recorded() as recorded:
        pair.prefill(*pair.prefill._inputs)
        pair.flow(*pair.flow._inputs)
    assert {
        "scaled_dot_product_attention",
        "_scaled_dot_product_flash_attention_for_cpu",
    } & recorded.names
    waits = {"_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "equal", "_unique2"}
    assert not waits & recorded.names


def test_inputs_of_other_shapes_are_refused(policy, make_batch):
    both(policy, inputs(policy, make_batch(policy)))
    with pytest.raises(ContractError, match="inputs of a graph"):
        recorded_pair(policy).flow(torch.zeros(1, 2, 3))


def test_prompts_go_to_the_next_bucket() -> None:
    tokens, mask = torch.ones(2, 50, dtype=torch.long), torch.ones(2, 50, dtype=torch.bool)
    longer, padded = bucketed(tokens, mask)
    assert longer.shape == padded.shape == (2, 96) and int(padded.sum()) == 100
    assert bucketed(tokens.repeat(1, 5), mask.repeat(1, 5))[0].shape[1] == 250 > BUCKETS[-1]


@pytest.mark.parametrize(("kind", "made"), [("fast", True), ("eager", False)])
def test_graphs_are_for_cuda_alone_and_can_be_turned_off(
    kind, made, make_policy, make_batch, monkeypatch
):
    policy = make_policy(sampler__kind=kind)
    policy.predict_action_chunk(make_batch(policy))
    assert policy.model.fast.graphed is None  # a CPU
    on_cuda = SimpleNamespace(device=torch.device("cuda"))
    assert (policy.model.fast._graphs(on_cuda) is not None) == made


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device: capture was never run")
def test_a_gpu_captures_them(make_policy, make_batch):
    policy = make_policy(touch__input="wrench", touch__start_at_base=True).to("cuda")
    batch = {
        k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in make_batch(policy).items()
    }
    given, noise = inputs(policy, batch), start_noise(policy).cuda()
    for _ in range(2):
        fast = ours(policy, given, noise)
    assert policy.model.fast.graphed is not None
    assert (lerobots_own(policy, given, noise) - fast).abs().max() < 1e-3


# a chunk at 112 px took a second instead of 40 ms
def test_keys_that_lie_apart_in_memory_cost_no_more():
    q, cache = torch.randn(1, 161, 8, 16).transpose(1, 2), torch.randn(161, 160)
    keys = cache[:, :16], cache[:, :16].clone()
    with torch.no_grad():
        assert torch.allclose(*(layers.attend_one(q, k, k, None) for k in keys), atol=1e-6)
        apart_s, close_s = (
            min(timeit.repeat(lambda k=k: layers.attend_one(q, k, k, None), number=1)) for k in keys
        )
    assert apart_s < 10 * close_s
