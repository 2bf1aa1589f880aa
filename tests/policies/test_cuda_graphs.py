"""What CUDA graphs would replay, run uncaptured on the CPU: same buffers, same functions, LeRobot's own actions.

Nothing here proves that a GPU can capture it; the last test does, where there is one.
"""

from types import SimpleNamespace

import pytest
import torch
from policy_samples import OPEN, alive, inputs, lerobots_own, ours, start_noise
from torch.utils._python_dispatch import TorchDispatchMode

from lerobot_policy_pi05_uniforce.sampler.cuda_graphs import BUCKETS, KEPT, GraphedSampler, bucketed
from uniforce_vtla.errors import ContractError

TOLERANCE = 1e-4


@pytest.fixture(params=["prefix", "suffix"])
def policy(request, make_policy):
    return graphed(make_policy, request.param)


def graphed(make_policy, site):
    """A policy with touch behind a half-open gate, whose norms do something, and uncaptured graphs."""
    policy = alive(make_policy(touch__input="wrench", touch__site=site, touch__start_at_base=True), OPEN)
    policy.model.fast.graphed = GraphedSampler(policy.model.fast, capture=False)
    return policy


def both(policy, given, steps=4):
    noise = start_noise(policy, len(given[2]))
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


def test_prompts_cameras_and_lost_fingers_change_and_the_actions_are_still_lerobots(policy, make_batch):
    images, masks, tokens, text_mask = inputs(policy, make_batch(policy))
    shorter = text_mask.clone()
    shorter[:, 9:] = False
    lost = [*masks[:-1], torch.tensor([True, False])]
    gone = [torch.zeros_like(masks[0]), *masks[1:]]
    for given in (
        (images, masks, tokens, text_mask),
        (images, masks, tokens, shorter),
        (images, lost, tokens, text_mask),
        (images, gone, tokens, text_mask),
        (images, masks, tokens, text_mask),
    ):
        slow, fast = both(policy, given)
        assert (slow - fast).abs().max() < TOLERANCE
    assert len(policy.model.fast.graphed._pairs) == 2  # with and without the camera; the rest are values


def test_pairs_are_not_kept_for_ever(policy, make_batch):
    given = inputs(policy, make_batch(policy))
    for steps in range(1, KEPT + 3):
        both(policy, given, steps)
    assert len(policy.model.fast.graphed._pairs) == KEPT


class Recorded(TorchDispatchMode):
    """Names of the operations that ran."""

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
    pair = policy.model.fast.graphed._latest
    with torch.no_grad(), Recorded() as recorded:
        pair.prefill(*pair.prefill._inputs)
        pair.flow(*pair.flow._inputs)
    assert {"scaled_dot_product_attention", "_scaled_dot_product_flash_attention_for_cpu"} & recorded.names
    waits = {"_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "equal", "_unique2"}
    assert not waits & recorded.names


def test_inputs_of_other_shapes_are_refused(policy, make_batch):
    both(policy, inputs(policy, make_batch(policy)))
    with pytest.raises(ContractError, match="inputs of a graph"):
        policy.model.fast.graphed._latest.flow(torch.zeros(1, 2, 3))


def test_prompts_go_to_the_next_bucket() -> None:
    tokens, mask = torch.ones(2, 50, dtype=torch.long), torch.ones(2, 50, dtype=torch.bool)
    longer, padded = bucketed(tokens, mask)
    assert longer.shape == padded.shape == (2, 96) and int(padded.sum()) == 100
    assert bucketed(tokens.repeat(1, 5), mask.repeat(1, 5))[0].shape[1] == 250 > BUCKETS[-1]


@pytest.mark.parametrize(("kind", "made"), [("fast", True), ("eager", False)])
def test_graphs_are_for_cuda_alone_and_can_be_turned_off(kind, made, make_policy, make_batch, monkeypatch):
    policy = make_policy(sampler__kind=kind)
    policy.predict_action_chunk(make_batch(policy))
    assert policy.model.fast.graphed is None  # a CPU
    on_cuda = SimpleNamespace(device=torch.device("cuda"))
    assert (policy.model.fast._graphs(on_cuda) is not None) == made


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device: capture was never run")
def test_a_gpu_captures_them(make_policy, make_batch):
    policy = make_policy(touch__input="wrench", touch__site="suffix", touch__start_at_base=True).to("cuda")
    batch = {k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in make_batch(policy).items()}
    given, noise = inputs(policy, batch), start_noise(policy).cuda()
    for _ in range(2):
        fast = ours(policy, given, noise)
    assert policy.model.fast.graphed is not None
    assert (lerobots_own(policy, given, noise) - fast).abs().max() < 1e-3
