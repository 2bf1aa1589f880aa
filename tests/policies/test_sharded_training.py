"""Full-size training shards weights over cards (FSDP): the same step as a whole policy's, and a whole checkpoint."""

import os
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy

PROGRAM = Path(__file__).with_name("sharded_program.py")


@pytest.mark.slow  # two processes import LeRobot, 10 s each
def test_a_sharded_step_is_the_whole_policys_step(make_policy, make_batch, tmp_path, run_to_the_end):
    still = {f"augment__{name}": 0.0 for name in ("touch_dropout", "touch_noise", "camera_variation")}
    policy = make_policy(**still, sampler__noise_scale=0.0, action__objective="regression")
    policy.save_pretrained(tmp_path / "begun")
    batch = {k: v.contiguous() for k, v in make_batch(policy, 4, actions=True).items() if torch.is_tensor(v)}
    save_file(batch, tmp_path / "batch.safetensors")
    launch = "torch.distributed.run --standalone --nproc-per-node=2"
    files = [tmp_path / "begun", tmp_path / "batch.safetensors", tmp_path / "sharded"]
    env = os.environ | {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo"}
    call = [sys.executable, "-m", *launch.split(), str(PROGRAM), *map(str, files)]
    run_to_the_end(call, env, tmp_path / "said", 200)
    whole = PI05UniforcePolicy.from_pretrained(tmp_path / "begun").train()
    optimizer = torch.optim.SGD([p for p in whole.parameters() if p.requires_grad], lr=1.0)
    losses = [whole({k: v.chunk(2)[i] for k, v in batch.items()})[0] for i in range(2)]
    torch.stack(losses).mean().backward()
    optimizer.step()
    before = load_file(tmp_path / "begun" / "model.safetensors")
    found = load_file(tmp_path / "sharded" / "model.safetensors")
    assert found.keys() == before.keys()
    moved = 0
    for name, weight in whole.state_dict().items():
        if name in found:
            torch.testing.assert_close(found[name], weight, rtol=1e-4, atol=1e-6)
            moved += not torch.equal(found[name], before[name])
    assert moved > 10
    PI05UniforcePolicy.from_pretrained(tmp_path / "sharded")
