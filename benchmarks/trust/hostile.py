"""Both clients against every fault of the stand-in: ``python -m benchmarks.trust.hostile [times=10]``; ``make faults``.

Each client is a program of its own, the two side by side. What is there already isn't tried again.
"""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.trust.hostile_trials import RIGHT_NAMES, HOLD_s, Trial, is_right
from benchmarks.trust.report import update
from uniforce_vtla.arguments import choose, parse

CLIENTS = ("pylibfranka", "franky")
HANG_s = 180.0  # without a new row; a trial takes 4 to 15 s, on a starved machine up to five times
POLL_s = 0.5


@dataclass
class HostileConfig:
    """Break the stand-in of the arm in every named way while each client moves it; see when the arm rests.

    Example: python -m benchmarks.trust.hostile times=10 out=docs/results/trust.json
    """

    times: int = 10  # trials of each fault with each client
    only: str = ""  # faults, comma between them; all when empty
    rows: str = "outputs/hostile"  # folder of the single trials; a run that was ended goes on from there
    out: str = "outputs/trust.json"  # the result file; only its key ``hostile_faults`` changes


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the trials of a file, none where there is no file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def try_client(client: str, faults: list[str], times: int, path: Path, bar: tqdm) -> list[dict[str, Any]]:
    """Run what a client lacks; a trial that hangs is a row too, and the next one gets a new process."""
    address = f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250}.{CLIENTS.index(client) + 2}"
    while lacks := _lacking(path, faults, times):
        flags = [client, ",".join(lacks), str(times), address, str(path)]
        program = [sys.executable, "-m", "benchmarks.trust.hostile_trials", *flags]
        log = path.with_suffix(".log")
        # a group of its own: a trial that is killed must not leave its stand-in holding the address
        with (
            log.open("a") as said,
            subprocess.Popen(program, stdout=said, stderr=said, start_new_session=True) as child,
        ):
            if not _watch(child, path, bar):
                _note_hang(path, client, _lacking(path, faults, times)[0])
        if child.returncode > 0:
            last = log.read_text().rstrip().rpartition("\n")[2]
            raise RuntimeError(f"{client}: expected trials, got exit code {child.returncode}: {last} Read {log}.")
    return read_rows(path)


def _lacking(path: Path, faults: list[str], times: int) -> list[str]:
    done = [row["fault"] for row in read_rows(path)]
    return [fault for fault in faults if done.count(fault) < times]


def _watch(child: subprocess.Popen, path: Path, bar: tqdm) -> bool:
    """Return True when the child has ended, False when it hung and was killed."""
    seen, since_s = len(read_rows(path)), time.monotonic()
    while child.poll() is None:
        time.sleep(POLL_s)
        if (now := len(read_rows(path))) > seen:
            bar.update(now - seen)
            seen, since_s = now, time.monotonic()
        if time.monotonic() - since_s > HANG_s:
            os.killpg(child.pid, signal.SIGKILL)
            return False
    bar.update(len(read_rows(path)) - seen)
    return True


def _note_hang(path: Path, client: str, fault: str) -> None:
    row = Trial(client, fault, "hang", f"no end within {HANG_s} s", float("inf"), HANG_s, 0, time.time())
    with path.open("a") as file:
        file.write(json.dumps(asdict(row)) + "\n")


def summarise(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return a line for each fault and client."""
    table: dict[str, dict[str, Any]] = {}
    for row in rows:
        line = table.setdefault(
            f"{row['fault']} {row['client']}",
            dict.fromkeys(("trials", "named_right", "held"), 0)
            | {"worst_hold_s": 0.0, "worst_learnt_s": 0.0, "sent_after": 0, "starved": 0},
        )
        line["trials"] += 1
        line["named_right"] += row["named"] in RIGHT_NAMES[row["fault"]]
        line["held"] += row["hold_s"] <= HOLD_s
        line["worst_hold_s"] = max(line["worst_hold_s"], row["hold_s"])
        line["worst_learnt_s"] = max(line["worst_learnt_s"], row["learnt_s"])
        line["sent_after"] += row["sent_after"]
        line["starved"] += row.get("starved", 0)
    return dict(sorted(table.items()))


def attack(faults: list[str], times: int, folder: Path) -> list[dict[str, Any]]:
    """Return every trial of both clients."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {client: folder / f"{client}.jsonl" for client in CLIENTS}
    left = sum(times - min(times, [r["fault"] for r in read_rows(p)].count(f)) for p in paths.values() for f in faults)
    with tqdm(total=left, desc="trials") as bar, ThreadPoolExecutor(len(CLIENTS)) as pool:
        jobs = [pool.submit(try_client, client, faults, times, path, bar) for client, path in paths.items()]
        return [row for job in jobs for row in job.result()]


def main(argv: list[str] | None = None) -> int:
    """Run the trials, write the table, print what went wrong; 1 where anything did."""
    config = parse(HostileConfig, argv)
    rows = attack(list(choose(RIGHT_NAMES, config.only)), config.times, Path(config.rows))
    wrong = [row for row in rows if not is_right(row)]
    path = update(Path(config.out), "hostile_faults", summarise(rows))
    for row in wrong:
        came = f"{row['named'] or 'nothing'}, held after {row['hold_s']} s, known after {row['learnt_s']} s"
        print(f"{row['client']} {row['fault']}: {came}. {row['message']}")
    print(
        f"{len(rows) - len(wrong)} of {len(rows)} trials right (named, held and known ≤ {HOLD_s} s); written to {path}"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
