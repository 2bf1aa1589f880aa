"""Trials in programs of their own, since a client may hang; and a retry on a starved machine."""

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.ledger import Ledger
from uniforce_vtla.errors import FaultError

STARTS = 5
POLL_s = 0.5
# a sleeper that wakes so late was on a machine that ran others meanwhile
NAP_s = 0.005
STARVED_s = 0.06
NONE_TRIED: dict[str, Any] = {
    "trials": 0,
    "named_right": 0,
    "held": 0,
    "worst_hold_s": -math.inf,
    "worst_learnt_s": -math.inf,
    "starved": 0,
}


def run_trials(
    module: str, kinds: Sequence[str], times: int, folder: Path, hang_s: float
) -> list[dict[str, Any]]:
    """Run the trials that the folder lacks and return all its rows; a row is stored as it comes.

    ``python -m module KIND,… TIMES FOLDER`` adds a row to the ledger of its kind. Without a new
    row for ``hang_s`` it is killed, which is a row too, and the next trial gets a new process.
    """
    rows = Ledger(folder)
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "trials.log"

    def done() -> int:
        return sum(len(rows.read(kind)) for kind in kinds)

    with tqdm(total=len(kinds) * times, desc="trials") as bar:
        while lacks := [kind for kind in kinds if len(rows.read(kind)) < times]:
            program = [sys.executable, "-m", module, ",".join(lacks), str(times), str(folder)]
            # a group of its own: a trial that is killed must not leave its stand-ins
            with (
                log.open("a") as said,
                subprocess.Popen(
                    program, stdout=said, stderr=said, start_new_session=True
                ) as child,
            ):
                hangs = _hangs(child, done, hang_s, bar)
                if hangs:
                    os.killpg(child.pid, signal.SIGKILL)
            if hangs:
                hung = next(kind for kind in kinds if len(rows.read(kind)) < times)
                row = {"kind": hung, "named": "hang", "message": f"no end within {hang_s:g} s"}
                rows.add(hung, row | {"hold_s": math.inf, "learnt_s": math.inf})
            elif child.returncode:
                last = log.read_text().rstrip().rpartition("\n")[2]
                raise RuntimeError(
                    f"expected trials, got exit code {child.returncode}: {last} Read {log}."
                )
    return [row for kind in kinds for row in rows.read(kind)]


def tally(trials: Sequence[Any]) -> dict[str, dict[str, Any]]:
    """Return a line per kind of trial, by name: how many were right, and the worst times."""
    found: dict[str, dict[str, Any]] = {}
    for one in sorted(trials, key=lambda trial: trial.kind):
        line = found.setdefault(one.kind, NONE_TRIED.copy())
        line["trials"] += 1
        line["named_right"] += one.is_named
        line["held"] += one.is_held
        line["worst_hold_s"] = max(line["worst_hold_s"], one.hold_s)
        line["worst_learnt_s"] = max(line["worst_learnt_s"], one.learnt_s)
        line["starved"] += one.starved
    return found


def _hangs(child: subprocess.Popen, done: Callable[[], int], hang_s: float, bar: tqdm) -> bool:
    """Wait for the child's end; return whether it hangs."""
    since_s = time.monotonic()
    while child.poll() is None:
        time.sleep(POLL_s)
        now = done()
        if now > bar.n:
            since_s = time.monotonic()
        bar.update(now - bar.n)
        if time.monotonic() - since_s > hang_s:
            return True
    bar.update(done() - bar.n)
    return False


class Sleeper(threading.Thread):
    """Measures for how long the machine ran others in one piece."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.late_s = 0.0
        self._runs = True

    def run(self) -> None:
        """Sleep, and note by how much each sleep was too long, until asked to end."""
        while self._runs:
            then_s = time.monotonic()
            time.sleep(NAP_s)
            self.late_s = max(self.late_s, time.monotonic() - then_s - NAP_s)

    def __enter__(self) -> "Sleeper":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._runs = False


def begun[T](
    name: str, trial: Callable[[], T], is_right: Callable[[T], bool]
) -> tuple[T, int, float]:
    """Return a trial, how often it was begun in vain, and by how much a sleeper woke too late, s.

    A trial that a starved machine stopped, before the fault or for another reason, is begun
    again. The last of ``STARTS`` counts; RuntimeError, FaultError: it never began.
    """
    for starved in range(STARTS):
        with Sleeper() as sleeper:
            try:
                found = trial()
            except (RuntimeError, FaultError) as error:
                print(f"{name}: not begun: {error}", file=sys.stderr)
                if starved == STARTS - 1:
                    raise
                continue
        if is_right(found) or sleeper.late_s < STARVED_s:
            break
        print(
            f"{name}: a starved machine, late by {sleeper.late_s:.3f} s: {found}", file=sys.stderr
        )
    return found, starved, round(sleeper.late_s, 3)
