"""Memory of loading a checkpoint: a sparse one of zeros, and a program that loads it."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import torch
from lerobot.configs import FeatureType, PolicyFeature

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, weights
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from uniforce_vtla.keys import ACTION, AXES, STATE

STATUS = Path("/proc/self/status")
DTYPES = {torch.float32: "F32", torch.bfloat16: "BF16", torch.float64: "F64", torch.int64: "I64"}


def write_sparse(folder, **settings):
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


def peak_bytes(folder):
    """Return how many bytes a fresh process grows by while it loads the checkpoint.

    The file's zeros take no disk, yet as much memory as any weights once loaded. The peak is VmHWM
    of the child, since getrusage's is inherited from the parent over fork.
    """
    call = [sys.executable, __file__, str(folder)]
    said = subprocess.run(call, capture_output=True, text=True, check=True).stdout.split()
    return int(said[-1])


def _status(field):
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(field))
    return 1024 * int(line.split()[1])


def main(folder):
    """Load the checkpoint, read every page of it, and print by how much the peak rose."""
    torch.set_num_threads(1)
    before = _status("VmRSS")
    policy = PI05UniforcePolicy.from_pretrained(folder, warm=False)
    for parameter in policy.parameters():
        float(parameter.detach().sum())
    sys.stdout.write(str(_status("VmHWM") - before))


if __name__ == "__main__":
    main(sys.argv[1])
