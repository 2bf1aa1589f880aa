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
from uniforce_vtla.errors import UniForceError

WAITING, STORED, REFUSED = r"is next: ", r"^(not )?stored", r"^can't begin"
UNDER_WAY_s = (0.7, 1.3)  # into an episode, before it is broken
NOTICE_s = 20.0  # a fault nobody has noticed by then never will be
UNWELL_s = 3.0  # then nobody gives up
FAULT = 3  # exit code


def attended(
    faults: dict[str, Breakage],
    plan: Plan,
    rig: Rig,
    program: Program,
    ledger: Ledger,
    root: Path,
    times: int,
) -> None:
    """Inject each until ``times`` findings of it are there; a person goes on after each one, and quits in the end.

    Args:
        faults: by name.
        plan: how patient to be.
        rig: whole.
        program: forks the session.
        ledger: gets the findings, also that the session hung or died; it ends then, and can be begun again.
        root: of the dataset; all faults go into one.
        times: each.
    """
    with Session(
        program, plan.argv(rig, root, operator="keys", episodes=EPISODES, episode_s=LONG_s)
    ) as session:
        at, clears = 0, False
        for name, fault in faults.items():
            while len(ledger.read(name)) < times:
                try:
                    at = _begin(session, plan, at, clears)
                    at, found = _break(session, fault, plan, rig, root, at)
                except UniForceError as error:
                    ledger.add(name, {"right_outcome": False, "message": str(error)})
                    return
                ledger.add(name, found)
                clears = fault.clears
        _quit(session, plan, at)


def _quit(session: Session, plan: Plan, at: int) -> None:
    session.wait_for(WAITING, START_s * plan.patience, at)
    session.press("q")
    code = session.wait_end(START_s * plan.patience)
    if code:
        raise TrialError(f"the session ended with exit code {code} though a person quit it")


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
    time.sleep(random.uniform(*UNDER_WAY_s))
    mark, broken_s = rig.mark(), time.monotonic()
    fault.breaks(rig)
    at, said = session.wait_for(STORED, NOTICE_s * plan.patience, at)
    found = finding(fault, root, said, broken_s, rig.rest(mark, broken_s))
    fault.mends(rig)
    return at, found


def finding(fault: Breakage, root: Path, said: Line, broken_s: float, held: dict[str, Any]) -> dict[str, Any]:
    """Return what came of a fault, by the terminal, the dataset and the arm's own log."""
    label = said.text.removeprefix("stored ").partition(",")[0]
    card = read_card(root, len(read_source(root).episodes) - 1)
    is_right = label in fault.labels and card["label"] == label and "hold_s" in held
    return {
        "label": label,
        "message": card["message"],
        "right_outcome": is_right,
        "stored_s": round(said.time_s - broken_s, 3),
        **held,
    }


def unattended(name: str, fault: Breakage, plan: Plan, rig: Rig, program: Program) -> dict[str, Any]:
    """Inject it once and leave it: nobody waits until the sensor is well, the exit code says that it wasn't."""
    root = plan.work / "faults" / f"{name}_nobody{time.time_ns()}"
    rig.new_arm()
    with Session(program, plan.argv(rig, root, episodes=1, episode_s=LONG_s, unwell_s=UNWELL_s)) as session:
        at, _ = session.wait_for(BEGUN, (START_s + NOTICE_s) * plan.patience)
        time.sleep(UNDER_WAY_s[0])
        mark, broken_s = rig.mark(), time.monotonic()
        fault.breaks(rig)
        _, said = session.wait_for(STORED, NOTICE_s * plan.patience, at)
        code = session.wait_end((START_s + UNWELL_s) * plan.patience)
        found = finding(fault, root, said, broken_s, rig.rest(mark, broken_s))
    return found | {"right_outcome": found["right_outcome"] and code == FAULT, "exit_code": code}
