"""Replay a function of tensors from a CUDA graph.

An eager call launches thousands of small kernels, and launching takes longer than running them.
A graph fixes shapes and addresses. So values are copied into buffers of its own, and the returned
result is a copy.

``capture=False`` runs the same functions on the same fixed buffers without a graph, on any device:
the tests do.
"""

from collections.abc import Callable

import torch
from torch import Tensor

KEPT = 6  # graphs: lengths of text times a camera that comes and goes; each holds its own buffers


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
