"""Every fault as often as wanted: was the robot held in time, was the outcome right?"""

import random
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.ledger import Ledger
from benchmarks.recorder.device_faults import BREAKAGES, Breakage, attended, unattended
from benchmarks.recorder.ending_faults import ENDINGS, Bench
from benchmarks.recorder.plan import Plan
from benchmarks.recorder.rig import Rig
from uniforce_vtla.errors import UniForceError

NAMES = (*BREAKAGES, *ENDINGS)


def run(plan: Plan, ledger: Ledger, names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    """Inject what is missing of each fault; return the findings of all."""
    left = [name for name in names if len(ledger.read(name)) < plan.times]
    if left:
        with Rig(plan, plan.folder / "faults" / "rig") as rig:
            _break_devices({n: BREAKAGES[n] for n in left if n in BREAKAGES}, ledger, rig)
            for name in left:
                while name in ENDINGS and (done := len(ledger.read(name))) < plan.times:
                    _note(name, ledger, partial(ENDINGS[name], bench_of(name, done, rig)))
    return {name: summary(ledger.read(name)) for name in NAMES if ledger.read(name)}


def _break_devices(faults: dict[str, Breakage], ledger: Ledger, rig: Rig) -> None:
    """Inject all but the last of each in one session, the last one in an unattended session."""
    root = rig.plan.folder / "faults" / "attended"
    by_hand = max(rig.plan.times - 1, 1)
    while any(len(ledger.read(name)) < by_hand for name in faults):
        rig.new_arm()
        attended(faults, rig, ledger, root, by_hand)
        for fault in faults.values():
            fault.mends(rig)
    for name, fault in faults.items():
        while len(ledger.read(name)) < rig.plan.times:
            _note(name, ledger, partial(unattended, name, fault, rig))
            fault.mends(rig)


def bench_of(name: str, number: int, rig: Rig) -> Bench:
    root = rig.plan.folder / "faults" / name / str(number)
    shutil.rmtree(root, ignore_errors=True)  # of a trial that was cut short
    return Bench(rig, root, random.Random(f"{name}{number}"))


def _note(name: str, ledger: Ledger, trial: Callable[[], dict[str, Any]]) -> None:
    """Add what a trial found; one that hung, died or left no dataset is a finding too."""
    try:
        ledger.add(name, trial())
    except UniForceError as error:
        ledger.add(name, {"right_outcome": False, "message": str(error)})


def summary(findings: list[dict[str, Any]]) -> dict[str, Any]:
    def known(key: str) -> list[Any]:
        return [finding[key] for finding in findings if finding.get(key) is not None]

    example = next(filter(None, known("message")), "")
    return {
        "trials": len(findings),
        "right_outcome": sum(bool(finding["right_outcome"]) for finding in findings),
        "worst_hold_s": max(known("hold_s"), default=None),
        "worst_rest_s": max(known("rest_s"), default=None),
        "slowest_arm_clock": min(known("arm_clock"), default=None),
        "labels": sorted(set(known("label"))),
        "exit_codes": sorted(set(known("exit_code"))),
        # results are committed, so that no path may name a folder of this machine
        "example": example.replace(f"{Path.cwd()}/", ""),
    }
