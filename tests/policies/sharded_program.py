"""One optimiser step of a policy sharded over processes: ``torchrun … sharded_program.py checkpoint
batch out``.

As LeRobot's trainer does it with FSDP: shard, step, gather all weights, save.  On a CPU two parts
aren't LeRobot's own: accelerate shards on accelerators only, and torch's gathering of a sharded
state reads freed memory there.
"""

import sys

import torch
from safetensors.torch import load_file
from torch import distributed
from torch.distributed.fsdp import FullyShardedDataParallel

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy


def main():
    checkpoint, batch, out = sys.argv[1:4]
    torch.set_num_threads(1)
    distributed.init_process_group("gloo")
    rank, size = distributed.get_rank(), distributed.get_world_size()
    policy = PI05UniforcePolicy.from_pretrained(checkpoint).train()
    whole = {name: len(tensor) for name, tensor in policy.state_dict().items() if tensor.dim()}
    sharded = FullyShardedDataParallel(policy, use_orig_params=True, device_id=torch.device("cpu"))
    optimizer = torch.optim.SGD([p for p in sharded.parameters() if p.requires_grad], lr=1.0)
    own = {key: tensor.chunk(size)[rank] for key, tensor in load_file(batch).items()}
    loss, _ = sharded(own)
    loss.backward()
    optimizer.step()
    with FullyShardedDataParallel.summon_full_params(sharded, writeback=False):
        weights = {name: tensor.clone() for name, tensor in policy.state_dict().items()}
    if rank == 0:
        assert {n: len(t) for n, t in weights.items() if t.dim()} == whole
        policy.save_pretrained(out, state_dict=weights)
    distributed.barrier()
    distributed.destroy_process_group()


if __name__ == "__main__":
    main()
