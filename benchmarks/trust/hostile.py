"""The robot against every fault of the stand-in; a trial that is there already isn't run again."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.ledger import Ledger, update
from benchmarks.trust.hostile_trials import RIGHT_NAMES, ROWS, HOLD_s, STILL_m, Trial, is_right
from uniforce_cli.boundary import command
from uniforce_vtla.arguments import choose

HANG_s = 180.0  # without a new row; a trial takes 4 to 15 s, on a starved machine up to five times
POLL_s = 0.5


@dataclass
class HostileConfig:
    """Break the stand-in of the arm in every named way while it moves; see when arm and hand rest.

    Example: python -m benchmarks.trust.hostile times=10 out=docs/results/trust.json
    """

    times: int = 10  # trials of each fault
    only: str = ""  # faults, comma between them; all when empty
    # folder of the single trials; a run that was ended goes on from there
    rows: str = "outputs/hostile"
    out: str = "outputs/trust.json"  # the result file; only its key ``hostile_faults`` changes


def attack(faults: list[str], times: int, folder: Path) -> list[dict[str, Any]]:
    """Run what is lacking and return all rows; a trial that hangs is a row too, and the next gets a new process."""
    address = f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250}.2"
    folder.mkdir(parents=True, exist_ok=True)
    rows, log = Ledger(folder), folder / "trials.log"
    with tqdm(total=len(_lacking(rows.read(ROWS), faults, times)), desc="trials") as bar:
        while lacks := _lacking(rows.read(ROWS), faults, times):
            flags = [",".join(dict.fromkeys(lacks)), str(times), address, str(folder)]
            program = [sys.executable, "-m", "benchmarks.trust.hostile_trials", *flags]
            # a group of its own: a trial that is killed must not leave its stand-in holding the address
            with (
                log.open("a") as said,
                subprocess.Popen(
                    program, stdout=said, stderr=said, start_new_session=True
                ) as child,
            ):
                if not _watch(child, partial(rows.read, ROWS), bar):
                    hung = _lacking(rows.read(ROWS), faults, times)[0]
                    what = f"no end within {HANG_s} s"
                    rows.add(
                        ROWS,
                        asdict(Trial(hung, "hang", what, float("inf"), HANG_s, 0, time.time())),
                    )
            if child.returncode > 0:
                last = log.read_text().rstrip().rpartition("\n")[2]
                raise RuntimeError(
                    f"expected trials, got exit code {child.returncode}: {last} Read {log}."
                )
    return rows.read(ROWS)


def _lacking(rows: list[dict[str, Any]], faults: list[str], times: int) -> list[str]:
    """Return the fault of each trial that is still to be run."""
    done = Counter(row["fault"] for row in rows)
    return [fault for fault in faults for _ in range(times - done[fault])]


def _watch(child: subprocess.Popen, rows: Callable[[], list[dict[str, Any]]], bar: tqdm) -> bool:
    """Return True when the child has ended, False when it hung and was killed."""
    seen, since_s = len(rows()), time.monotonic()
    while child.poll() is None:
        time.sleep(POLL_s)
        if (now := len(rows())) > seen:
            bar.update(now - seen)
            seen, since_s = now, time.monotonic()
        if time.monotonic() - since_s > HANG_s:
            os.killpg(child.pid, signal.SIGKILL)
            return False
    bar.update(len(rows()) - seen)
    return True


def summarise(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    groups = defaultdict[str, list[dict[str, Any]]](list)
    for row in rows:
        groups[row["fault"]].append(row)
    return {
        name: {
            "trials": len(own),
            "named_right": sum(row["named"] in RIGHT_NAMES[name] for row in own),
            "held": sum(row["hold_s"] <= HOLD_s and row["fingers_m"] <= STILL_m for row in own),
            "worst_hold_s": max(row["hold_s"] for row in own),
            "worst_learnt_s": max(row["learnt_s"] for row in own),
            "worst_fingers_mm": round(1000 * max(row["fingers_m"] for row in own), 2),
            "sent_after": sum(row["sent_after"] for row in own),
            "starved": sum(row.get("starved", 0) for row in own),
        }
        for name, own in sorted(groups.items())
    }


@command(HostileConfig)
def main(config: HostileConfig) -> int:
    """Run the trials, write the table, print what went wrong; 1 where anything did."""
    rows = attack(list(choose(RIGHT_NAMES, config.only)), config.times, Path(config.rows))
    wrong = [row for row in rows if not is_right(row)]
    path = update(Path(config.out), "hostile_faults", summarise(rows))
    for row in wrong:
        came = f"{row['named'] or 'nothing'}, held after {row['hold_s']} s, known after {row['learnt_s']} s"
        print(f"{row['fault']}: {came}, fingers {1000 * row['fingers_m']:.1f} mm. {row['message']}")
    print(
        f"{len(rows) - len(wrong)} of {len(rows)} trials right (named, held and known ≤ {HOLD_s} s); written to {path}"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
