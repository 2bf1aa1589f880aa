"""One table and one picture: how much of its clean success an arm keeps under each operator and dose."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.stress.disturbed import SCENE_OPERATORS
from benchmarks.stress.rollouts import mean_corruption_error
from uniforce_vtla.figure_file import save_figure

Arms = Mapping[str, Mapping[str, Any]]  # arm → operator → row of ``summarise``
COSTLY = 0.2  # of clean wipes: a fault that costs as much has to be noticed


def one_table(
    arms: Arms, screened: Mapping[str, Any], without_touch: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the form of stress.json: what was rolled out, operator by operator, and what was only screened.

    Args:
        arms: what ``summarise`` gives, the policy's own sensor first.
        screened: what the screen gives.
        without_touch: ``clean`` and ``n`` of a policy without touch and without a fault, where none was rolled out.
    """
    policies = [name for name in arms if name.startswith("policy on ")]
    own = policies[0]
    blind, unwatched = arms.get("policy without touch", {}), arms.get("policy without monitor", {})
    operators = {}
    for name in (name for name in arms[own] if name):
        reader = "expert" if name in SCENE_OPERATORS else own.replace("policy on", "expert reads")
        row = dict(arms[own][name]) | {
            "expert": arms[reader][name]["clean"],
            "expert_n": arms[reader][name]["n"],
            "expert_benign": arms[reader][name]["benign"],
        }
        for other in policies[1:]:
            if name in arms[other]:
                row[other] = arms[other][name]
        for label, others in (
            ("policy without touch", blind),
            ("policy without monitor", unwatched),
        ):
            if name in others:
                row[label] = {key: others[name][key] for key in ("clean", "n")}
        operators[name] = row
    return {
        "clean_without_fault": {
            name: {key: found[""][key] for key in ("clean", "n")} for name, found in arms.items()
        },
        "operators": operators,
        "mce": mean_corruption_error(arms[own], blind or {"": without_touch}),
        "screened": screened,
    }


def monitor_row(
    arms: Arms, noticed: Mapping[str, Any], warned: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what the monitor is worth where it matters: AUROC of what costs 20 points or more, and of the rest.

    Args:
        arms: as for ``one_table``; a fault's price is that without the monitor where that was rolled out.
        noticed: one kind's part of monitor.json.
        warned: fault → what became of the scenes in which the unwatched twin failed.
    """
    own = next(iter(arms.values()))
    found: dict[str, Any] = {"auroc": {}, "auroc_mild": {}}
    for name, seen in noticed["operators"].items():
        unwatched = arms.get("policy without monitor", {})
        arm = unwatched if name in unwatched else own
        lost = (
            dict(zip(arm[name]["doses"], lost_share(arm[name], arm[""]), strict=True))
            if name in arm
            else {}
        )
        for cell in (cell for cell in seen["cells"] if cell["dose"] in lost):
            found["auroc" if lost[cell["dose"]] >= COSTLY else "auroc_mild"][
                f"{name} {cell['dose']:g}"
            ] = cell["auroc"]
    clean = noticed["clean"]
    return found | {
        "false_alarms_per_hour": clean["false_alarms"] / clean["hours"],
        **clean,
        "warned": warned,
    }


def lost_share(row: Mapping[str, Any], usual: Mapping[str, Any]) -> np.ndarray:
    """Return how much of its clean share an arm loses under each dose."""
    return usual["clean"] / usual["n"] - np.array(row["clean"]) / np.maximum(row["n"], 1)


def retention(row: Mapping[str, Any], usual: Mapping[str, Any]) -> np.ndarray:
    """Return clean under each dose over clean without a fault, at most 1."""
    share = np.array(row["clean"]) / np.maximum(row["n"], 1)
    return np.minimum(share / max(usual["clean"] / usual["n"], 1e-9), 1.0)


def draw(table: Mapping[str, Any], path: Path) -> Path:
    """Draw a row per operator that was rolled out, doses mild to severe, each with clean of n."""
    operators, usual = table["operators"], table["clean_without_fault"]
    own = next(iter(usual))
    columns = max(len(row["doses"]) for row in operators.values())
    kept = np.full((len(operators), columns), np.nan)
    for index, row in enumerate(operators.values()):
        kept[index, : len(row["doses"])] = retention(row, usual[own])
    figure = Figure(
        figsize=(max(7.5, 2.2 + 1.6 * columns), 1.2 + 0.42 * len(operators)), layout="constrained"
    )
    axes = figure.subplots()
    image = axes.imshow(kept, vmin=0, vmax=1, cmap="RdYlGn", aspect="auto")
    for index, row in enumerate(operators.values()):
        for column, dose in enumerate(row["doses"]):
            counts = [
                f"{row[k][column]}/{row[n][column]}"
                for k, n in (("clean", "n"), ("expert", "expert_n"))
            ]
            said = f"{dose:g} {row['unit']}\n{counts[0]}, expert {counts[1]}"
            axes.text(column, index, said, ha="center", va="center", fontsize=7)
    axes.set_yticks(range(len(operators)), list(operators), fontsize=8)
    axes.set_xticks([])
    axes.set_xlabel("doses that were rolled out, mild to severe")
    clean = usual[own]
    axes.set_title(
        f"{own}: clean under a fault over clean without ({clean['clean']}/{clean['n']}), simulated",
        fontsize=9,
    )
    figure.colorbar(image, label="kept")
    return save_figure(figure, path)
