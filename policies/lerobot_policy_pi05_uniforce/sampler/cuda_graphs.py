"""Replay the fast sampler's kernels from CUDA graphs: one for the prefill, one for the flow.

An eager call launches thousands of small kernels, and launching takes longer than running them. A graph fixes shapes
and addresses, so inputs are copied into buffers of its own, text is padded to one of a few lengths (one pair of graphs
each), masks are always there, and what is returned is a copy. The flow's graph reads the keys and values where the
first leaves them.

Whatever is captured is an ordinary function of tensors. ``capture=False`` runs the same functions on the same fixed
buffers without a graph, on any device: that is what the tests do. Graphs were recorded once, by a bench on an H200
(docs/results/policy_latency.json).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler.layers import Prepared, StepTable
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs, Prefill, Prefix, PrefixEncoder
from lerobot_policy_pi05_uniforce.touch.felt import Felt
from lerobot_policy_pi05_uniforce.touch.tokens import GatedColumns, SuffixTouch
from uniforce_vtla.errors import ContractError, expected

Recordable = Callable[..., tuple[Tensor, ...]]
BUCKETS = (48, 96, 200)  # text tokens: a short prompt, one with many state digits, π0.5's most
KEPT = 6  # pairs of graphs: buckets times a camera that comes and goes; each holds its own buffers


class Replayed:
    """A function of tensors on fixed buffers, recorded into a CUDA graph or (without ``capture``) called again.

    Args:
        function: tensors in, a tuple of tensors out; no shape or branch may depend on values.
        inputs: an example; shapes, dtypes and device stay.
        capture: record a graph (CUDA).
    """

    def __init__(self, function: Recordable, inputs: list[Tensor], capture: bool) -> None:
        self._function = function
        self._inputs = [value.clone() for value in inputs]
        self._graph: torch.cuda.CUDAGraph | None = None
        if capture:
            self._graph, self.outputs = _record(function, self._inputs)
        else:
            self.outputs = tuple(value.clone() for value in function(*self._inputs))

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the outputs for ``inputs``, in buffers that the next call overwrites.

        Raises ContractError: inputs of other shapes than the example's.
        """
        wanted, came = (
            [tuple(value.shape) for value in values] for values in (self._inputs, inputs)
        )
        if wanted != came:
            raise ContractError(
                expected(
                    "inputs of a graph", wanted, came, "Record another graph for other shapes."
                )
            )
        for own, new in zip(self._inputs, inputs, strict=True):
            own.copy_(new)
        if self._graph is not None:
            self._graph.replay()
            return self.outputs
        for own, new in zip(self.outputs, self._function(*self._inputs), strict=True):
            own.copy_(new)
        return self.outputs


class Pair(NamedTuple):
    """The two graphs of one set of shapes; the flow's reads the buffers that the prefill's writes."""

    prefill: Replayed
    flow: Replayed


class Sampler(Protocol):
    """The sampler that is recorded: a ``FastSampler``."""

    network: Any
    prepared: Prepared
    encoder: PrefixEncoder

    def flow(self, prefix: Prefix, noise: Tensor, tables: list[StepTable]) -> Tensor:
        """Return the actions at the end of the flow."""


class GraphedSampler:
    """Samples like the ``FastSampler`` it is given, by replay; without ``capture`` (tests, CPU) by calling again."""

    def __init__(self, sampler: Sampler, capture: bool = True) -> None:
        self._sampler, self._capture = sampler, capture
        self._pairs: dict[tuple, Pair] = {}
        self._version = -1

    def sample(self, inputs: Inputs, noise: Tensor, tables: list[StepTable]) -> Tensor:
        """Return (B, chunk, max_action_dim) actions of inputs that are all there."""
        touch = self._sampler.network.suffix_touch(inputs.felt)
        text = bucketed(inputs.tokens, inputs.masks)
        whole = inputs._replace(tokens=text[0], masks=text[1])
        observed = flattened(whole)
        suffix = [noise] if touch is None else [noise, touch.tokens, touch.mask]
        pair = self._pair(whole, suffix, tables)
        pair.prefill(*observed)
        return pair.flow(*suffix)[0].clone()

    def _pair(self, inputs: Inputs, suffix: list[Tensor], tables: list[StepTable]) -> Pair:
        if self._version != self._sampler.prepared.version:  # other weights: tables were made anew
            self._pairs, self._version = {}, self._sampler.prepared.version
        shapes = (tuple(value.shape) for value in (*flattened(inputs), *suffix))
        key = (len(tables), len(inputs.images), *shapes)
        if key not in self._pairs:
            while len(self._pairs) >= KEPT:
                self._pairs.pop(next(iter(self._pairs)))
            self._pairs[key] = self._record_pair(inputs, suffix, tables)
        return self._pairs[key]

    def _record_pair(self, example: Inputs, suffix: list[Tensor], tables: list[StepTable]) -> Pair:
        encoder = self._sampler.encoder
        chunk, room = suffix[0].shape[1], sum(part.shape[1] for part in suffix[:2])
        gated_at: list[int] = []  # first column of touch: a number, fixed with the shapes

        def prefill(*given: Tensor) -> tuple[Tensor, ...]:
            made = encoder.prefill(restored(given, example), room, always_mask=True)
            gated_at[:] = [] if made.gated is None else [made.gated.first]
            gate = () if made.gated is None else (made.gated.bias, made.gated.real)
            return (made.pads, *gate, *made.cache)

        recorded = Replayed(prefill, flattened(example), self._capture)
        pads, *rest = recorded.outputs
        gated = GatedColumns(gated_at[0], *rest[:2]) if gated_at else None
        whole = Prefill(rest[2 * len(gated_at) :], pads, gated)

        def flow(noise: Tensor, *touch: Tensor) -> tuple[Tensor, ...]:
            run = SuffixTouch(*touch) if touch else None
            prefix = encoder.with_suffix(whole, run, chunk, always_mask=True)
            return (self._sampler.flow(prefix, noise, tables),)

        return Pair(recorded, Replayed(flow, suffix, self._capture))


def flattened(inputs: Inputs) -> list[Tensor]:
    """Return the tensors of an observation, one behind the other."""
    state = [] if inputs.felt.state is None else [inputs.felt.state]
    felt = [*state, *inputs.felt.touches, *inputs.felt.masks]
    return [*inputs.images, *inputs.img_masks, inputs.tokens, inputs.masks, *felt]


def restored(tensors: Sequence[Tensor], example: Inputs) -> Inputs:
    """Return the observation that ``flattened`` took apart, of as many cameras and slots as an example."""
    rest = list(tensors)

    def take(count: int) -> list[Tensor]:
        taken = rest[:count]
        del rest[:count]
        return taken

    images = take(len(example.images))
    img_masks = take(len(example.images))
    tokens, masks = take(2)
    state = None if example.felt.state is None else take(1)[0]
    touches = take(len(example.felt.touches))
    felt = Felt(state, tuple(touches), tuple(rest))
    return Inputs(images, img_masks, tokens, masks, felt)


def bucketed(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Pad (B, L) text to the next of ``BUCKETS``, masked: a prompt of another length then finds its graph."""
    room = (
        next((size for size in BUCKETS if size >= tokens.shape[1]), tokens.shape[1])
        - tokens.shape[1]
    )
    return F.pad(tokens, (0, room)), F.pad(masks.bool(), (0, room))


def _record(
    function: Recordable, inputs: list[Tensor]
) -> tuple[torch.cuda.CUDAGraph, tuple[Tensor, ...]]:
    """Run twice aside, as torch asks for, then record; return the graph and the buffers it writes."""
    aside = torch.cuda.Stream()
    aside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(aside):
        for _ in range(2):
            function(*inputs)
    torch.cuda.current_stream().wait_stream(aside)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        outputs = function(*inputs)
    return graph, outputs
