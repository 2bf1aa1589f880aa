"""One table: how much of its clean success an arm keeps under each fault."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.stress.disturbed import SCENE_OPERATORS
from benchmarks.stress.rollouts import mean_corruption_error

Arms = Mapping[str, Mapping[str, Any]]  # arm → operator → row of ``summarise``
COSTLY = 0.2  # of clean wipes: a fault that costs as much has to be noticed


def one_table(
    arms: Arms, screened: Mapping[str, Any], without_touch: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the form of stress.json: what was rolled out by operator, and what was only screened.

    Args:
        arms: what ``summarise`` gives, the policy's own sensor first.
        screened: the stored screen.
        without_touch: ``clean`` and ``n`` of a policy without touch and without a fault, where none
            was rolled out.
    """
    own, *others = [name for name in arms if name.startswith("policy on ")]
    blind = arms.get("policy without touch", {})
    operators = {}
    for name, row in arms[own].items():
        if not name:
            continue
        reader = own.replace("policy on", "expert reads")
        if name in SCENE_OPERATORS:
            reader = "expert"
        expert = arms[reader][name]
        operators[name] = dict(row)
        operators[name]["expert"] = expert["clean"]
        operators[name]["expert_n"] = expert["n"]
        operators[name]["expert_benign"] = expert["benign"]
        for other in others:
            if name in arms[other]:
                operators[name][other] = arms[other][name]
        for other in ("policy without touch", "policy without monitor"):
            if name in arms.get(other, {}):
                operators[name][other] = _counts(arms[other][name])
    return {
        "clean_without_fault": {name: _counts(found[""]) for name, found in arms.items()},
        "operators": operators,
        "mce": mean_corruption_error(arms[own], blind or {"": without_touch}),
        "screened": screened,
    }


def _counts(row: Mapping[str, Any]) -> dict[str, Any]:
    return {"clean": row["clean"], "n": row["n"]}


def monitor_row(
    arms: Arms, noticed: Mapping[str, Any], warned: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the monitor's AUROC of what costs 20 points or more, and of the rest.

    Args:
        arms: as for ``one_table``; a fault's price is that without the monitor where that was
            rolled out.
        noticed: one kind's part of monitor.json.
        warned: fault → what became of the scenes in which the unwatched twin failed.
    """
    own = next(iter(arms.values()))
    unwatched = arms.get("policy without monitor", {})
    found: dict[str, Any] = {"auroc": {}, "auroc_mild": {}}
    for name, seen in noticed["operators"].items():
        arm = unwatched if name in unwatched else own
        if name not in arm:
            continue
        lost = arm[""]["clean"] / arm[""]["n"] - _share(arm[name])
        price = dict(zip(arm[name]["doses"], lost, strict=True))
        for cell in seen["cells"]:
            dose = cell["dose"]
            if dose in price:
                kind = "auroc" if price[dose] >= COSTLY else "auroc_mild"
                found[kind][f"{name} {dose:g}"] = cell["auroc"]
    clean = noticed["clean"]
    found["false_alarms_per_hour"] = clean["false_alarms"] / clean["hours"]
    return found | {**clean, "warned": warned}


def _share(row: Mapping[str, Any]) -> np.ndarray:
    """Return the share of clean wipes under each dose."""
    return np.array(row["clean"]) / np.maximum(row["n"], 1)
