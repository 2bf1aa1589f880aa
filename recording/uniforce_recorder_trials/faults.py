"""Every fault as often as wanted: was the robot held in time, was the outcome the right one, did nothing hang?"""

from __future__ import annotations

import random
import shutil
from typing import Any

from tqdm import tqdm

from uniforce_recorder_trials.ending_faults import ENDINGS, Bench
from uniforce_recorder_trials.fault_table import BREAKAGES
from uniforce_recorder_trials.ledger import Ledger
from uniforce_recorder_trials.plan import Plan
from uniforce_recorder_trials.rig import Rig
from uniforce_recorder_trials.running_faults import attended, unattended
from uniforce_recorder_trials.session import Program, TrialError

NAMES = (*BREAKAGES, *ENDINGS)


def run(plan: Plan, ledger: Ledger, names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    """Inject what is missing of each fault; return the findings of all."""
    left = [name for name in names if len(ledger.read(name)) < plan.times]
    if left:
        with Rig(plan.work / "faults" / "rig", plan.options) as rig, Program() as program:
            for name in tqdm(left, desc="faults", unit="fault"):
                _inject(name, plan, ledger, rig, program)
    return {name: summary(ledger.read(name)) for name in NAMES if ledger.read(name)}


def _inject(name: str, plan: Plan, ledger: Ledger, rig: Rig, program: Program) -> None:
    while (done := len(ledger.read(name))) < plan.times:
        try:
            if name in ENDINGS:
                ledger.add(name, _end_a_session(name, done, plan, rig, program))
            else:
                _break_a_device(name, done, plan, ledger, rig, program)
        except TrialError as error:
            ledger.add(name, {"right_outcome": False, "message": str(error)})


def _end_a_session(name: str, number: int, plan: Plan, rig: Rig, program: Program) -> dict[str, Any]:
    root = plan.work / "faults" / name / str(number)
    shutil.rmtree(root, ignore_errors=True)  # of a trial that was cut short
    return ENDINGS[name](Bench(plan, rig, program, root, random.Random(f"{name}{number}{plan.seed}")))


def _break_a_device(name: str, done: int, plan: Plan, ledger: Ledger, rig: Rig, program: Program) -> None:
    fault = BREAKAGES[name]
    fault.mends(rig)
    rig.new_arm()
    by_hand = plan.times if fault.goes_on else plan.times - 1  # the last one with nobody there
    if done < by_hand:
        attended(name, fault, plan, rig, program, ledger, by_hand)
    else:
        unattended(name, fault, plan, rig, program, ledger)


def summary(findings: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts and the worst of a fault's findings."""
    holds_s = [finding["hold_s"] for finding in findings if finding.get("hold_s") is not None]
    labels = sorted({finding["label"] for finding in findings if "label" in finding})
    codes = sorted({finding["exit_code"] for finding in findings if "exit_code" in finding})
    return {
        "trials": len(findings),
        "right_outcome": sum(bool(finding["right_outcome"]) for finding in findings),
        "worst_hold_s": max(holds_s) if holds_s else None,
        "labels": labels,
        "exit_codes": codes,
        "example": next((f["message"] for f in findings if f.get("message")), ""),
    }
