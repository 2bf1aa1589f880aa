"""Replay the fast sampler's kernels from CUDA graphs: one for the prefill, one for the flow.

An eager call launches thousands of small kernels, and launching takes longer than running them.
A graph fixes shapes and addresses. So inputs are copied into buffers of its own, text is padded to
one of a few lengths (one pair of graphs each), masks are always there, and the returned actions are
a copy. The flow's graph reads the keys and values where the prefill's leaves them.

``capture=False`` runs the same functions on the same fixed buffers without a graph, on any device:
the tests do. A bench on an H200 recorded graphs (docs/results/policy_latency.json).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler.layers import StepTable
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs, Prefill
from lerobot_policy_pi05_uniforce.touch.tokens import Felt
from uniforce_vtla.errors import ContractError, expected

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.sampler.fast import FastSampler

BUCKETS = (48, 96, 200)  # text tokens: a short prompt, one with many state digits, π0.5's most
KEPT = 6  # pairs of graphs: buckets times a camera that comes and goes; each holds its own buffers


class Replayed[Result]:
    """A function of fixed buffers, recorded into a CUDA graph or called again.

    Args:
        function: reads the buffers; no shape or branch may depend on their values.
        inputs: the buffers.
        outputs: takes a result apart into its tensors, the buffers that the next call overwrites.
        capture: record a graph (CUDA).
    """

    def __init__(
        self,
        function: Callable[[], Result],
        inputs: list[Tensor],
        outputs: Callable[[Result], list[Tensor]],
        capture: bool,
    ) -> None:
        self._function = function
        self._inputs = inputs
        self._outputs = outputs
        self._graph: torch.cuda.CUDAGraph | None = None
        if capture:
            self._graph = torch.cuda.CUDAGraph()
            aside = torch.cuda.Stream()  # torch asks for calls aside before one is recorded
            aside.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(aside):
                function()
                function()
            torch.cuda.current_stream().wait_stream(aside)
            with torch.cuda.graph(self._graph):
                self.result = function()
        else:
            self.result = function()

    def __call__(self, *inputs: Tensor) -> Result:
        """Return the result for ``inputs``.

        Raises ContractError: inputs of other shapes than the buffers'.
        """
        wanted = [tuple(value.shape) for value in self._inputs]
        came = [tuple(value.shape) for value in inputs]
        if wanted != came:
            do = "Record another graph for other shapes."
            raise ContractError(expected("inputs of a graph", wanted, came, do))
        _copy(inputs, self._inputs)
        if self._graph is not None:
            self._graph.replay()
        else:
            _copy(self._outputs(self._function()), self._outputs(self.result))
        return self.result


def _copy(sources: list[Tensor] | tuple[Tensor, ...], buffers: list[Tensor]) -> None:
    for source, buffer in zip(sources, buffers, strict=True):
        buffer.copy_(source)


class Pair(NamedTuple):
    """The two graphs of one set of shapes; the flow reads the buffers that the prefill writes."""

    prefill: Replayed[Prefill]
    flow: Replayed[Tensor]


class GraphedSampler:
    """Samples like the ``FastSampler`` it is given, by replay."""

    def __init__(self, sampler: FastSampler, capture: bool = True) -> None:
        self._sampler = sampler
        self._capture = capture
        self._pairs: dict[tuple, Pair] = {}
        self._version = -1

    def sample(self, inputs: Inputs, noise: Tensor, tables: list[StepTable]) -> Tensor:
        """Return (B, chunk, max_action_dim) actions of inputs that are all there."""
        tokens, masks = bucketed(inputs.tokens, inputs.masks)
        inputs = inputs._replace(tokens=tokens, masks=masks)
        pair = self._pair(inputs, noise, tables)
        pair.prefill(*flattened(inputs))
        return pair.flow(noise).clone()

    def _pair(self, inputs: Inputs, noise: Tensor, tables: list[StepTable]) -> Pair:
        if self._version != self._sampler.prepared.version:  # other weights: tables were made anew
            self._pairs = {}
            self._version = self._sampler.prepared.version
        shapes = [tuple(value.shape) for value in (*flattened(inputs), noise)]
        key = (len(tables), len(inputs.images), *shapes)
        if key not in self._pairs:
            while len(self._pairs) >= KEPT:
                self._pairs.pop(next(iter(self._pairs)))
            self._pairs[key] = self._record_pair(inputs, noise, tables)
        return self._pairs[key]

    def _record_pair(self, inputs: Inputs, noise: Tensor, tables: list[StepTable]) -> Pair:
        encoder = self._sampler.encoder
        chunk = noise.shape[1]
        observed = copied(inputs)
        start = noise.clone()

        def prefill() -> Prefill:
            return encoder.prefill(observed, chunk, always_mask=True)

        def flow() -> Tensor:
            prefix = encoder.with_suffix(recorded.result, chunk, always_mask=True)
            return self._sampler.flow(prefix, start, tables)

        recorded = Replayed(prefill, flattened(observed), Prefill.tensors, self._capture)
        flowing = Replayed(flow, [start], lambda actions: [actions], self._capture)
        return Pair(recorded, flowing)


def flattened(inputs: Inputs) -> list[Tensor]:
    """Return the tensors of an observation, one behind the other."""
    felt = inputs.felt
    seen = [*inputs.images, *inputs.img_masks, inputs.tokens, inputs.masks]
    return [*seen, *filter(torch.is_tensor, (felt.state, felt.touches, felt.masks))]


def copied(inputs: Inputs) -> Inputs:
    """Return an observation in memory of its own."""
    felt = []
    for part in (inputs.felt.state, inputs.felt.touches, inputs.felt.masks):
        felt.append(None if part is None else part.clone())
    images = list(map(torch.clone, inputs.images))
    img_masks = list(map(torch.clone, inputs.img_masks))
    return Inputs(images, img_masks, inputs.tokens.clone(), inputs.masks.clone(), Felt(*felt))


def bucketed(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Pad (B, L) text to the next of ``BUCKETS``, masked, so that another length finds a graph."""
    length = tokens.shape[1]
    room = min((size - length for size in BUCKETS if size >= length), default=0)
    return F.pad(tokens, (0, room)), F.pad(masks.bool(), (0, room))
