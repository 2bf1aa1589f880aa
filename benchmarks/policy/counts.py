"""Operations of a call: floating point, and of the dispatcher; and the memory of loading a checkpoint."""

import json
import math
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import FlopCounterMode

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, weights
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from lerobot_policy_pi05_uniforce.sampler.layers import AVAILABLE
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import ACTION, AXES, STATE

VIEWS = {  # operations that move no data
    *(
        "alias",
        "as_strided",
        "detach",
        "expand",
        "permute",
        "select",
        "slice",
        "split",
        "split_with_sizes",
    ),
    *("squeeze", "t", "transpose", "unbind", "unsqueeze", "view", "_unsafe_view"),
}
STATUS = Path("/proc/self/status")
DTYPES = {torch.float32: "F32", torch.bfloat16: "BF16", torch.float64: "F64", torch.int64: "I64"}


def _linear_flops(*given: Any, **_: Any) -> int:
    """Return the work of oneDNN's linear, plain (x, weight, bias, …) or with an operand more (x, other, weight, …)."""
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


def bench_memory(**settings: Any) -> dict[str, float]:
    """Return file size and peak [GB] and their ratio for a policy of these settings, loaded in a fresh process.

    The checkpoint is a synthetic one of the real names and shapes. Its file is sparse: its zeros take no disk, yet as
    much memory as any weights once loaded. The peak is VmHWM of a fresh child, since getrusage's is inherited from the
    parent over fork. Raises ContractError: no /proc here (Linux only).
    """
    if not STATUS.exists():
        raise ContractError(expected("memory", "Linux's /proc", "none", "Leave memory= out."))
    with TemporaryDirectory() as folder:
        size = write_sparse(Path(folder), **settings)
        call = [sys.executable, "-m", __name__, folder]
        said = subprocess.run(call, capture_output=True, text=True, check=True).stdout.split()
    grown = float(said[-1])
    return {"checkpoint_GB": size / 1e9, "peak_GB": grown / 1e9, "ratio": grown / size}


def write_sparse(folder: Path, **settings: Any) -> int:
    """Write config and zero weights of a policy with true-wrench touch; return the file's bytes."""
    config = PI05UniforceConfig(
        device="cpu",
        touch=TouchSettings(input="wrench"),
        input_features={STATE: PolicyFeature(FeatureType.STATE, (len(AXES),))},
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (len(AXES),))},
        **settings,
    )
    policy = PI05UniforcePolicy(config, empty=True)  # the backbone has no memory yet
    header, end = {}, 0
    for name, tensor in policy.state_dict().items():
        start, end = end, end + tensor.numel() * tensor.element_size()
        header[name] = {
            "dtype": DTYPES[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [start, end],
        }
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    with (folder / weights.WEIGHTS).open("wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        file.truncate(8 + len(text) + end)
    config.save_pretrained(folder)
    return 8 + len(text) + end


def _status(field: str) -> int:
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(field))
    return 1024 * int(line.split()[1])


def main(folder: str) -> None:
    """Load the checkpoint, read every page of it, and print how many bytes the process's peak rose."""
    torch.set_num_threads(1)
    before = _status("VmRSS")
    policy = PI05UniforcePolicy.from_pretrained(folder, warm=False)
    for parameter in policy.parameters():
        float(parameter.detach().sum())
    print(_status("VmHWM") - before)


if __name__ == "__main__":
    main(sys.argv[1])
