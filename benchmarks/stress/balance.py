"""Does the grip of two fingers tell that one is wrong in scale? Expert wipes, with and without faults of scale."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.stress.monitor import auroc
from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.readings import encode_now
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_cli.boundary import Level, command, worker_process
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import SensorError
from uniforce_vtla.options import Count, OutFile, Text, Workers, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.finger_balance import EVERY, FingerBalance, imbalance

OWN = "tactip:1"  # on the right finger
SCALE = ("G1 stiffer", "G1 softer", "G2 keener", "G2 duller")
# development scenes; other units are those whose wipes set the limits of the monitor (benchmarks.stress.monitor)
CLEAN_FROM, OTHERS_FROM, FAULTY_FROM, FIRST_OTHER = 39_640, 39_720, 39_600, 40


@dataclass
class BalanceCommand:
    """Let the expert wipe by the true wrench with faults of scale on the right finger, and compare both fingers' grip.

    Example: python -m benchmarks.stress.balance left=gelsight:1,uskin:1 out=outputs/balance.json
    """

    left: Text = "gelsight:1,uskin:1"  # worn on the left finger, comma between them
    level: Level = "touch"
    # wipes without a fault, by the demonstrations' TacTip; and by others, one wipe each
    clean: Count = 16
    faulty: Count = 4  # wipes per fault and dose
    workers: Workers = 2
    out: OutFile = "outputs/balance.json"


def wipe(level: str, left: str, right: str, seed: int) -> float | None:
    """Return how many times the left finger's grip the right one reads; None: the wipe ended first, or was refused."""
    worker_process()
    tokenizer, head = Tokenizer.from_pretrained(), ForceHead.from_pretrained()
    env, balance = WipeEnv(level, left, right), FingerBalance()
    try:
        for step, _ in enumerate(walk(env, WipeExpert(), seed)):
            if step % EVERY:
                continue
            left_N, right_N = (
                float(head(encode_now(env, finger, tokenizer))[0, 2]) for finger in FINGERS
            )
            if (times := balance.see(right_N, left_N)) is not None:
                return times
    except SensorError:
        pass
    return None


def wipes(
    config: BalanceCommand, left: str, rows: Iterable[tuple[str, int]], desc: str
) -> list[float]:
    """Return the judged wipes' ratios."""
    jobs = [delayed(wipe)(config.level, left, right, seed) for right, seed in rows]
    found = Parallel(config.workers, return_as="generator")(jobs)
    return [
        times
        for times in tqdm(found, total=len(jobs), desc=desc, disable=None)
        if times is not None
    ]


def cell(times: list[float], clean: list[float]) -> dict[str, Any]:
    """Return how wipes with a fault differ from clean ones: ratio, share noticed, AUROC."""
    odd, usual = ([imbalance(one) for one in found] for found in (times, clean))
    return {
        "n": len(times),
        "times": round(float(np.exp(np.log(times).mean())), 3) if times else None,
        "noticed": sum(one > 1 for one in odd),
        "auroc": auroc(odd, usual) if odd else None,
    }


def measure(config: BalanceCommand, left: str) -> dict[str, Any]:
    clean = wipes(
        config, left, [(OWN, CLEAN_FROM + n) for n in range(config.clean)], f"{left}, clean"
    )
    other_rows = [(f"tactip:{FIRST_OTHER + n}", OTHERS_FROM + n) for n in range(config.clean)]
    others = wipes(config, left, other_rows, f"{left}, other TacTips")
    found: dict[str, Any] = {
        "clean": cell(clean, clean) | {"spread": round(float(np.log(clean).std()), 3)},
        "other_units": cell(others, clean) | {"spread": round(float(np.log(others).std()), 3)},
        "operators": {},
    }
    for name in SCALE:
        cells = []
        for dose in OPERATORS[name].doses:
            rows = [
                (str(worn_with(OPERATORS[name], OWN, dose)), FAULTY_FROM + n)
                for n in range(config.faulty)
            ]
            cells.append(
                {"dose": dose} | cell(wipes(config, left, rows, f"{left}, {name} {dose:g}"), clean)
            )
        found["operators"][name] = cells
    return found


@command(BalanceCommand)
def main(config: BalanceCommand) -> None:
    """Entry of ``python -m benchmarks.stress.balance``."""
    torch.set_num_threads(1)
    found = {left: measure(config, left) for left in split(config.left)}
    for left, rows in found.items():
        print(f"{left}: clean {rows['clean']}; other units {rows['other_units']}")
        for name, cells in rows["operators"].items():
            said = "  ".join(
                f"{c['dose']:g}: ×{c['times']}, {c['noticed']}/{c['n']}, {c['auroc']}"
                for c in cells
            )
            print(f"  {name:12} {said}")
    print(
        f"written to {write_json(Path(config.out), {'level': config.level, 'left': found} | provenance())}"
    )


if __name__ == "__main__":
    sys.exit(main())
