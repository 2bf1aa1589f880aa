"""Give a checkpoint from before ``touch.carried_N`` what its demonstrations' finger read while it carried.

The scripted demonstrations of its seeds are driven again and read as the policy reads. A checkpoint that is trained on
a view of today needs none of this: training fills the field.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from joblib import Parallel, delayed
from tqdm import tqdm

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from lerobot_policy_pi05_uniforce.touch.sensors import carried_grip
from uniforce_cli.boundary import Level, Worn, command, one_thread, worker_process
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.file_hashes import drop_hashes, write_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Count, FolderPath, Workers
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

EVERY = 3  # steps between two looks: a grip changes slowly


@dataclass
class CarriedGripCommand:
    """Measure what a demonstrations' finger reads of grip once lifted, and store it in a checkpoint.

    Example: python -m benchmarks.policy.carried_grip demos=50
    """

    policy: FolderPath = ""  # checkpoint folder; empty = the shipped one
    slot: Literal["touch0", "touch1"] = "touch0"
    finger: Literal["left", "right"] = "right"  # that the slot's demonstrations wore
    sensor: Worn = "tactip"  # on it, in words
    level: Level = "touch"
    demos: Count = 50  # scenes from 0 on
    workers: Workers = 2


def demonstration(
    level: str, finger: Finger, sensor: str, seed: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a scripted demonstration's measured state (T, 5) and what its finger reads (T, 3), N."""
    worker_process()
    tokenizer = Tokenizer.from_pretrained()
    head = ForceHead.from_pretrained(sensor.partition(":")[0])
    encode = tokenizer.pooled
    worn = {f"{finger}_sensor": sensor}
    env = WipeEnv(level, drawn=(finger,), **worn)  # type: ignore[arg-type]
    states: list[np.ndarray] = []
    forces: list[torch.Tensor] = []
    for step, _ in enumerate(walk(env, WipeExpert(), seed)):
        if step % EVERY == 0:
            reference, current = env.marker_pair(finger)
            states.append(env.state)
            forces.append(head(encode(reference, current[None], finger)))
    return torch.from_numpy(np.stack(states)), torch.cat(forces).float()


def demonstrations(config: CarriedGripCommand) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Yield all of them, with a bar."""
    what = config.level, config.finger, config.sensor
    jobs = [delayed(demonstration)(*what, seed) for seed in range(config.demos)]
    yield from tqdm(
        Parallel(config.workers, return_as="generator")(jobs),
        total=len(jobs),
        desc="demonstrations",
    )


@command(CarriedGripCommand)
def main(config: CarriedGripCommand) -> int:
    """Measure, store, print."""
    one_thread()
    folder = Path(config.policy) if config.policy else shipped_checkpoint()
    carried_N = carried_grip(demonstrations(config))
    if carried_N is None:
        print("nothing is ever lifted: nothing is stored")
        return 1
    file = folder / "config.json"
    settings = read_object(file, CheckpointError)
    settings["touch"]["carried_N"] = {config.slot: round(carried_N, 3)}
    drop_hashes(folder)
    file.write_text(json.dumps(settings, indent=4))
    write_hashes(folder)
    print(f"{config.slot}: {carried_N:.2f} N once lifted; stored in {file}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
