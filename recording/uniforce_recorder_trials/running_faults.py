"""Break a device while an episode runs: in one attended session again and again, and once with nobody there."""

from __future__ import annotations

import random
import time
from pathlib import Path
from typing import Any

from uniforce_datasets.cards import read_card
from uniforce_datasets.source import read_source
from uniforce_recorder_trials.end_to_end import BEGUN, START_s
from uniforce_recorder_trials.fault_table import Breakage
from uniforce_recorder_trials.ledger import Ledger
from uniforce_recorder_trials.plan import EPISODES, LONG_s, Plan
from uniforce_recorder_trials.rig import Rig
from uniforce_recorder_trials.session import Line, Program, Session, TrialError
from uniforce_recorder_trials.stillness import hold_s

WAITING, STORED, REFUSED = r"is next: ", r"^(not )?stored", r"^can't begin"
UNDER_WAY_s = (0.7, 1.3)  # into an episode, before it is broken
REST_s = 0.6  # after it, before the arm's log is read
NOTICE_s = 20.0  # a fault nobody has noticed by then never will be
GARBAGE_s = 1.0  # how long an episode has to endure it
UNWELL_s = 3.0  # then nobody gives up
FAULT = 3  # exit code


def attended(
    name: str, fault: Breakage, plan: Plan, rig: Rig, program: Program, ledger: Ledger, times: int
) -> None:
    """Inject a fault until ``times`` findings are there; a person goes on after each, and quits in the end."""
    root, rng = plan.work / "faults" / name, random.Random(f"{name}{plan.seed}")
    settings = {"operator": "keys", "episodes": EPISODES, "episode_s": LONG_s}
    with Session(program, plan.argv(rig, root, **settings)) as session:
        at = 0
        while len(ledger.read(name)) < times:
            at = _begin(session, plan, at, fault.clears and at > 0)
            time.sleep(rng.uniform(*UNDER_WAY_s))
            at, finding = _break(session, fault, plan, rig, root, at)
            ledger.add(name, finding)
        session.wait_for(WAITING, START_s * plan.patience, at)
        session.press("q")
        code = session.wait_end(START_s * plan.patience)
    if code:
        raise TrialError(f"{name}: the session ended with exit code {code} though a person quit it")


def _begin(session: Session, plan: Plan, at: int, clears: bool) -> int:
    """Press keys until an episode runs; return the number of the line that says so."""
    deadline_s = time.monotonic() + (START_s + NOTICE_s) * plan.patience
    at, _ = session.wait_for(WAITING, START_s * plan.patience, at)
    if clears:
        session.press("v")
        at, _ = session.wait_for(r"recovered", NOTICE_s * plan.patience, at)
    while True:
        session.press(" ")
        at, said = session.wait_for(f"{BEGUN}|{REFUSED}", START_s * plan.patience, at + 1)
        if not said.text.startswith("can't"):
            return at
        if time.monotonic() > deadline_s:
            raise TrialError(f"no episode begins: {said.text}")
        time.sleep(0.1)


def _break(
    session: Session, fault: Breakage, plan: Plan, rig: Rig, root: Path, at: int
) -> tuple[int, dict[str, Any]]:
    mark = rig.mark()
    broken_s = time.monotonic()
    fault.breaks(rig)
    if fault.goes_on:
        time.sleep(GARBAGE_s)
        session.press("y")
    at, said = session.wait_for(STORED, NOTICE_s * plan.patience, at)
    time.sleep(REST_s)
    wire = rig.wire(mark)
    fault.mends(rig)
    return at, finding(fault, plan, root, said, broken_s, None if fault.goes_on else hold_s(wire, broken_s))


def finding(
    fault: Breakage, plan: Plan, root: Path, said: Line, broken_s: float, held_s: float | None
) -> dict[str, Any]:
    """Return what came of a fault, by the terminal, the dataset and the arm's own log."""
    label = said.text.removeprefix("stored ").partition(",")[0]
    last = len(read_source(root).episodes) - 1
    card = read_card(root, last)
    return {
        "label": label,
        "message": card["message"],
        "right_outcome": label in fault.labels
        and card["label"] == label
        and (fault.goes_on or held_s is not None),
        "named_exactly": label == fault.labels[0],
        "hold_s": None if held_s is None else round(held_s, 3),
        "stored_s": round(said.time_s - broken_s, 3),
        "sensor": {name: card["sensors"]["tactile_right"][name] for name in ("samples", "lost", "bad")},
    }


def unattended(name: str, fault: Breakage, plan: Plan, rig: Rig, program: Program, ledger: Ledger) -> None:
    """Inject it once and leave it: nobody waits until the sensor is well, the exit code says that it wasn't."""
    root = plan.work / "faults" / f"{name}_nobody"
    rig.new_arm()
    argv = plan.argv(rig, root, episodes=1, episode_s=LONG_s, unwell_s=UNWELL_s)
    with Session(program, argv) as session:
        at, _ = session.wait_for(BEGUN, (START_s + NOTICE_s) * plan.patience)
        time.sleep(UNDER_WAY_s[0])
        mark, broken_s = rig.mark(), time.monotonic()
        fault.breaks(rig)
        _, said = session.wait_for(STORED, NOTICE_s * plan.patience, at)
        code = session.wait_end((START_s + UNWELL_s) * plan.patience)
        time.sleep(REST_s)
        held_s = hold_s(rig.wire(mark), broken_s)
    fault.mends(rig)
    found = finding(fault, plan, root, said, broken_s, held_s)
    right = found["right_outcome"] and code == FAULT
    ledger.add(name, found | {"right_outcome": right, "exit_code": code})
