"""Is a dropped tool noticed without touch, by the hand alone? And is it ever said of one that is held?"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.ledger import update
from benchmarks.scene_blocks import BLOCKS
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from uniforce_cli.boundary import Level, command, one_thread, worker_process
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import RobotError
from uniforce_vtla.options import Count, OutFile, Seed, Workers

HELD_PHASES = ("lift", "carry", "lower", "wipe")
LATEST_s = 8.0  # after the grasp at which it is dropped, at most
NOTICED_s = 3.0  # afterwards in which the hand may notice
SLIPPERY = 0.02  # friction of pads that something makes slide
How = Literal["pulled", "slips", ""]


@dataclass
class DroppedToolCommand:
    """Let the expert wipe with the hand, drop the tool in some episodes, and count what the hand says.

    Example: python -m benchmarks.gates.dropped_tool out=docs/results/reading_expert.json
    """

    level: Level = "touch"
    drops: Count = 20  # episodes in which the tool is pulled out or slips out, in turns
    wipes: Count = 100  # episodes in which it isn't
    first_seed: Seed = BLOCKS["dropped tool"].start
    workers: Workers = 2
    out: OutFile = "outputs/reading_expert.json"  # only its key ``dropped_tool`` changes


def episode(level: str, seed: int, how: How) -> dict[str, Any]:
    """Return what the hand said of one episode, and how long after the drop."""
    worker_process()
    env = WipeEnv(level, drawn=(), gripper="hand")
    env.start(seed)
    expert = WipeExpert()
    expert.reset(env)
    drop_s = float(np.random.default_rng([seed, 99]).uniform(0.5, LATEST_s))
    held_steps = 0
    dropped_at: int | None = None
    step = 0
    done = False
    try:
        while not done:
            held_steps += expert.phase in HELD_PHASES
            if how and dropped_at is None and held_steps > drop_s * CONTROL_HZ:
                _drop(env, how)
                dropped_at = step
            done = env.advance(expert.act(env))
            step += 1
            late = dropped_at is not None and step - dropped_at > NOTICED_s * CONTROL_HZ
            done = done or late
    except RobotError as error:
        after_s = None if dropped_at is None else (step - dropped_at) / CONTROL_HZ
        return {"seed": seed, "how": how, "said": error.fault, "after_s": after_s}
    return {"seed": seed, "how": how, "said": "", "after_s": None}


def _drop(env: WipeEnv, how: How) -> None:
    model, data = env.sim.model, env.sim.data
    if how == "slips":
        for finger in FINGERS:
            model.geom(f"pad_{finger}").friction[:] = SLIPPERY
        return
    address = int(model.joint("eraser").qposadr[0])
    data.qpos[address : address + 3] = (0.2, 0.4, 0.1)


@command(DroppedToolCommand)
def main(config: DroppedToolCommand) -> int:
    """Run all, write the counts; 1 where a drop was missed or an alarm false."""
    one_thread()
    hows: list[How] = ["pulled" if number % 2 else "slips" for number in range(config.drops)]
    hows += [""] * config.wipes
    jobs = [
        delayed(episode)(config.level, config.first_seed + number, how)
        for number, how in enumerate(hows)
    ]
    rows = list(
        tqdm(
            Parallel(config.workers, return_as="generator")(jobs), total=len(jobs), desc="episodes"
        )
    )
    drops = [row for row in rows if row["how"]]
    noticed = [row for row in drops if row["said"] == "grasp_lost" and row["after_s"] is not None]
    false_alarms = [row for row in rows if not row["how"] and row["said"]]
    worst_s = max((row["after_s"] for row in noticed), default=None)
    found = {
        "drops": len(drops),
        "noticed": len(noticed),
        "worst_after_s": worst_s,
        "wipes": config.wipes,
        "false_alarms": len(false_alarms),
        "missed": [row for row in drops if row not in noticed],
    }
    print(
        f"{len(noticed)} of {len(drops)} noticed, after {worst_s} s at most; {len(false_alarms)} false alarms"
    )
    print(f"written to {update(Path(config.out), 'dropped_tool', found)}")
    return int(len(noticed) < len(drops) or bool(false_alarms))


if __name__ == "__main__":
    sys.exit(main())
