"""Replay a whole call of the fast sampler, prefix and flow, from one CUDA graph.

Touch is encoded before it, from a graph of its own (``touch/encoder.py``): the health monitor, on
the host, decides between latents and actions.

An eager call launches thousands of small kernels, and launching takes longer than running them.
A graph fixes shapes and addresses. So inputs are copied into buffers of its own, text is padded to
one of a few lengths (a graph each), masks are always there, and the returned actions are a copy.

``capture=False`` runs the same functions on the same fixed buffers without a graph, on any device:
the tests do.
"""

from __future__ import annotations

import copy
import functools
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler.layers import StepTable
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.sampler.fast import FastSampler

logger = logging.getLogger(__name__)

BUCKETS = (96, 200)  # text tokens: a usual prompt, and π0.5's most
KEPT = 6  # graphs: buckets times a camera that comes and goes; each holds buffers of its own


class Recording:
    """A function of fixed buffers, recorded into a CUDA graph or called again.

    Args:
        function: reads the buffers; no shape or branch may depend on their values.
        buffers: overwritten by each call's values.
        capture: record a graph (CUDA).
    """

    def __init__(
        self, function: Callable[[], Tensor], buffers: list[Tensor], capture: bool
    ) -> None:
        self.function = function
        self.buffers = buffers
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
                self._result = function()
        else:
            self._result = function()

    def __call__(self, values: list[Tensor]) -> Tensor:
        """Return a copy of the result for ``values``, of the buffers' shapes."""
        for buffer, value in zip(self.buffers, values, strict=True):
            buffer.copy_(value)
        if self._graph is not None:
            self._graph.replay()
        else:
            self._result = self.function()
        return self._result.clone()


class Recordings:
    """The last few recordings of a function, one for each set of shapes."""

    def __init__(self, capture: bool = True) -> None:
        self.capture = capture
        self.kept: dict[tuple, Recording] = {}

    def call(self, key: tuple, values: list[Tensor], record: Callable[[], Recording]) -> Tensor:
        """Return the result for ``values``; ``record`` makes a recording of their shapes."""
        shapes = [(tuple(value.shape), value.dtype, value.device) for value in values]
        key = (*key, *shapes)
        if key not in self.kept:
            while len(self.kept) >= KEPT:
                self.kept.pop(next(iter(self.kept)))
            self.kept[key] = record()
        return self.kept[key](values)


class GraphedSampler:
    """Samples like the ``FastSampler`` it is given, by replay."""

    def __init__(self, sampler: FastSampler, capture: bool = True) -> None:
        self.recordings = Recordings(capture)
        self._sampler = sampler
        self._version = -1
        # one compiled form of each function, for all recordings
        self._compiled = functools.cache(functools.partial(torch.compile, dynamic=False))

    def sample(self, inputs: Inputs, noise: Tensor, tables: list[StepTable]) -> Tensor:
        """Return (B, chunk, max_action_dim) actions of inputs that are all there."""
        if self._version != self._sampler.prepared.version:  # other weights: tables were made anew
            self.recordings.kept.clear()
            self._version = self._sampler.prepared.version
        tokens, masks = bucketed(inputs.tokens, inputs.masks)
        inputs = inputs._replace(tokens=tokens, masks=masks)
        key = (len(tables), len(inputs.images))
        record = functools.partial(self._record, inputs, noise, tables)
        return self.recordings.call(key, flattened(inputs, noise), record)

    def _record(self, inputs: Inputs, noise: Tensor, tables: list[StepTable]) -> Recording:
        observed, start = copy.deepcopy((inputs, noise))
        buffers = flattened(observed, start)
        run = functools.partial(self._sampler.run, observed, start, tables, always_mask=True)
        if self._sampler.compiles and inputs.tokens.shape[1] <= BUCKETS[0]:
            compiled = functools.partial(run, through=self._compiled)
            try:
                return Recording(compiled, buffers, self.recordings.capture)
            except RuntimeError as error:  # of dynamo, inductor, Triton or its C compiler
                self._sampler.compiles = False
                reason = str(error).partition("\n")[0][:200]
                logger.warning("torch.compile fails, kernels run as they are: %s", reason)
        return Recording(run, buffers, self.recordings.capture)


def flattened(inputs: Inputs, noise: Tensor) -> list[Tensor]:
    """Return the tensors of a call, one behind the other."""
    felt = inputs.felt
    seen = [*inputs.images, *inputs.img_masks, inputs.tokens, inputs.masks, noise]
    return [*seen, *filter(torch.is_tensor, (felt.state, felt.touches, felt.masks))]


def bucketed(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Pad (B, L) text to the next of ``BUCKETS``, masked, so that another length finds a graph."""
    length = tokens.shape[1]
    room = min((size - length for size in BUCKETS if size >= length), default=0)
    return F.pad(tokens, (0, room)), F.pad(masks.bool(), (0, room))
