"""Filling a network from a file: strict, by name, and without ever holding the weights twice."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from lerobot_policy_pi05_uniforce.weights import fill, no_weights
from uniforce_vtla.errors import CheckpointError

LOAD = """
import sys, psutil, torch
from pathlib import Path
torch.set_num_threads(1)
from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
before = psutil.Process().memory_info().rss
policy = PI05UniforcePolicy.from_pretrained(sys.argv[1])
total = sum(float(p.sum()) for p in policy.parameters())  # every page was really there
status = Path("/proc/self/status").read_text()  # getrusage would tell the parent's peak, inherited over fork
peak = 1024 * int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])
print((peak - before) / int(sys.argv[2]))
"""


def test_an_empty_module_is_filled_and_equal(tmp_path: Path) -> None:
    full = nn.Sequential(nn.Linear(4, 3), nn.BatchNorm1d(3))
    save_file(full.state_dict(), tmp_path / "w.safetensors")
    with no_weights():
        empty = nn.Sequential(nn.Linear(4, 3), nn.BatchNorm1d(3))
    assert empty[0].weight.is_meta
    fill(empty, tmp_path / "w.safetensors")
    x = torch.randn(5, 4)
    assert torch.equal(full.eval()(x), empty.eval()(x))
    assert empty[0].weight.requires_grad


def test_every_tensor_that_does_not_fit_is_named(tmp_path: Path) -> None:
    tensors = {"weight": torch.zeros(3, 5), "other": torch.zeros(1), "left.over": torch.zeros(1)}
    save_file(tensors, tmp_path / "w.safetensors")
    with pytest.raises(CheckpointError) as error:
        fill(nn.Linear(4, 3), tmp_path / "w.safetensors")
    assert all(word in str(error.value) for word in ("misshapen", "weight", "bias", "other", "left.over"))


def test_names_are_changed_dropped_or_left_to_the_module(tmp_path: Path) -> None:
    save_file({"net.weight": torch.ones(3, 4), "head": torch.zeros(1)}, tmp_path / "w.safetensors")
    module = nn.Linear(4, 3)
    own = module.bias.detach().clone()
    names = {"net.weight": "weight"}
    fill(module, tmp_path / "w.safetensors", names.get, fresh=("bias",))
    assert bool((module.weight == 1).all()) and torch.equal(module.bias, own)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc")
def test_a_checkpoint_is_never_held_twice(make_config, make_policy, tmp_path: Path) -> None:
    """200 MB of weights in a process of their own: memory grows by the weights and little else."""
    wide = {"tiny_width": 1024, "tiny_depth": 3, "tiny_mlp_dim": 2048, "tiny_head_dim": 64}
    policy = make_policy(touch_input="none", **wide)
    policy.save_pretrained(tmp_path)
    size = (tmp_path / "model.safetensors").stat().st_size
    assert size > 150e6
    del policy
    call = [sys.executable, "-c", LOAD, str(tmp_path), str(size)]
    found = subprocess.run(call, capture_output=True, text=True, check=True, timeout=240)
    assert (
        0.9 < float(found.stdout.split()[-1]) < 1.15 + 20e6 / size
    )  # 20 MB: what a forward's buffers may take
