"""Filling a network from a file: strict, by name, and without ever holding the weights twice."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from lerobot_policy_pi05_uniforce.bench_memory import bench_memory
from lerobot_policy_pi05_uniforce.weights import fill, no_weights
from uniforce_vtla.errors import CheckpointError


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


def test_tensors_lie_where_new_ones_would(tmp_path: Path) -> None:
    """A checkpoint's own layout would show in the last bits of what a policy answers."""
    layer = nn.Sequential(nn.Linear(3, 5), nn.Linear(5, 1))
    save_file({name: value.clone() for name, value in layer.state_dict().items()}, tmp_path / "w.safetensors")
    fill(layer, tmp_path / "w.safetensors")
    assert all(weight.data_ptr() % 64 == 0 for weight in layer.parameters())


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


@pytest.mark.slow  # a fresh process imports LeRobot: 10 s
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc")
def test_a_checkpoint_is_never_held_twice() -> None:
    """200 MB of weights in a process of their own: memory grows by the weights and little else."""
    wide = {"tiny_width": 1024, "tiny_depth": 3, "tiny_mlp_dim": 2048, "tiny_head_dim": 64}
    found = bench_memory(size="tiny", image_resolution=(28, 28), **wide)
    assert found["checkpoint_GB"] > 0.15
    assert 0.9 < found["ratio"] < 1.15 + 0.02 / found["checkpoint_GB"]  # 20 MB: buffers of a forward
