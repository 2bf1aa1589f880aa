"""A second device for tests on a CPU: tensors that say ``meta`` and compute, and that refuse to
meet those of the CPU.

A tensor made without ``device=``, or brought to the CPU on the way, meets one of the device sooner
or later and fails as on a GPU. Transfers to the host are counted: reading a number makes a GPU's
queue run dry.
"""

import contextlib
from unittest import mock

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

NAME = "meta"  # the one device beside the CPU that torch has everywhere
CROSSES = ("aten::_to_copy", "aten::copy_")


class Far(torch.Tensor):
    """A tensor of the device; its numbers lie in ``near``."""

    near: torch.Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, near):
        far = torch.Tensor._make_wrapper_subclass(
            cls, near.shape, near.stride(), near.storage_offset(), dtype=near.dtype, device=NAME
        )
        far.near = near
        return far

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class FarDevice(TorchDispatchMode):
    """Makes tensors of the device while it is entered; counts the numbers that cross to the
    host."""

    def __init__(self):
        super().__init__()
        self.crossed = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if func._schema.name == "aten::_local_scalar_dense" and isinstance(args[0], Far):
            self.crossed.append(1)
        to = kwargs.get("device")
        if func._schema.name == "aten::_to_copy" and isinstance(args[0], Far) and _is_host(to):
            self.crossed.append(args[0].numel())
        return _run(func, args, kwargs)


class _Written(TorchFunctionMode):
    """``torch.tensor`` of numbers in the program, which no dispatcher sees being made."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if func is not torch.tensor:
            return func(*args, **kwargs)
        device = kwargs.pop("device", None) or "cpu"
        return func(*args, **kwargs).to(device)


def _is_host(device):
    return device is not None and torch.device(device).type == "cpu"


def _run(func, args, kwargs):
    """Run an operation on the numbers; its results are on the device if its tensors are, or if it
    was asked for."""
    name = func._schema.name
    tensors = [x for x in tree_flatten((args, kwargs))[0] if isinstance(x, torch.Tensor)]
    is_far = any(isinstance(x, Far) for x in tensors)
    strangers = [x for x in tensors if not isinstance(x, Far) and x.dim() > 0]
    if is_far and strangers and name not in CROSSES:
        raise RuntimeError(
            f"{name}: all tensors on one device, got {NAME} and cpu {strangers[0].shape}"
        )
    asked = kwargs.get("device")
    if asked is not None:
        is_far = torch.device(asked).type == NAME
        kwargs = kwargs | {"device": torch.device("cpu")}
    near_args, near_kwargs = tree_map(_near, (args, kwargs))
    with contextlib.suppress(StopIteration), torch.utils._python_dispatch._disable_current_modes():
        found = func(*near_args, **near_kwargs)
    if name.endswith("_") and tensors:  # in place: the tensor itself
        return args[0]
    return tree_map(lambda x: Far(x) if is_far and isinstance(x, torch.Tensor) else x, found)


def _near(x):
    return x.near if isinstance(x, Far) else x


@contextlib.contextmanager
def far_device():
    """Let tensors be made on, and moved to, the device; autocast doesn't know it."""
    with mock.patch.object(torch, "autocast", mock.MagicMock()), _Written(), FarDevice() as device:
        yield device
