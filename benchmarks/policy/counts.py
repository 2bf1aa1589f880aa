"""Operations of a call: floating point, and of the dispatcher."""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import FlopCounterMode

from lerobot_policy_pi05_uniforce.sampler.layers import AVAILABLE

# operations that move no data
VIEWS = {
    "alias",
    "as_strided",
    "detach",
    "expand",
    "permute",
    "select",
    "slice",
    "split",
    "split_with_sizes",
    "squeeze",
    "t",
    "transpose",
    "unbind",
    "unsqueeze",
    "view",
    "_unsafe_view",
}


def _linear_flops(*given: Any, **_: Any) -> int:
    """Return the work of oneDNN's linear: (x, weight, bias, …), or (x, other, weight, …)."""
    weight = given[1] if isinstance(given[3], str) else given[2]
    return int(2 * math.prod(given[0]) * weight[0])


def count_flops(call: Callable) -> int:
    ours = {torch.ops.mkldnn._linear_pointwise: _linear_flops} if AVAILABLE else {}
    with FlopCounterMode(display=False, custom_mapping=ours) as counter:
        call()
    return int(counter.get_total_flops())


class _Operations(TorchDispatchMode):
    """Counts what the dispatcher is asked for, views aside: a launch each on a GPU."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += func._schema.name.split("::")[1] not in VIEWS
        return func(*args, **(kwargs or {}))


def count_operations(call: Callable) -> int:
    with _Operations() as counter:
        call()
    return counter.count
