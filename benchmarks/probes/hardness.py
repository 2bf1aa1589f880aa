"""Where the newtons go: the same transfers with one hardness taken away at a time, beside what no image holds.

Heads are trained on the hard training set throughout; only the scored set gets easier.  ``oracle`` is a reader of the
true force behind every image: it errs by what no image holds, a unit's own gain and what its rubber still holds back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.probes.disturbances import Creep, lagging_force
from benchmarks.probes.hard_sets import HETERO_HARD, HardSettings
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import POOL, Table, encode_set, learnt_row, mean_cells, score, transfer_name
from benchmarks.probes.zero_shot_figure import AXES
from uniforce_vtla.contact.sequences import press_shear_release
from uniforce_vtla.contact.units import Look
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig

SEQUENCES = 60  # per sensor: half of the frozen set's, the same contacts for every variant
STILL = Look(shift_mm=0.0, turn_rad=0.0, zoom=0.0, marker_size=(1.0, 1.0), tilt=0.0)


def variants() -> dict[str, HardSettings]:
    """Return the recipes by what was taken away."""
    base = replace(HETERO_HARD, sequences=SEQUENCES)
    without: dict[str, dict[str, Any]] = {
        "nothing": {},
        "canonicaliser": {"canonicalise": False},
        "camera poses": {"look": STILL},
        "lost markers": {"marker_loss": 0.0},
        "creep": {"creep_share": (0.0, 0.0)},
        "unit spread": {"unit_strength": 0.0},
    }
    everything = {key: value for change in without.values() for key, value in change.items()}
    without["all of it"] = everything
    return {
        name: replace(base, name=f"hardness_without_{name.replace(' ', '_')}", **change)
        for name, change in without.items()
    }


def hardness(
    tokenizer: Tokenizer,
    training: dict[str, LabelledSet],
    draw: Callable[[HardSettings], dict[str, LabelledSet]],
    seeds: int,
    head: HeadTrainingConfig | None = None,
) -> dict[str, Any]:
    """Return per variant the mean error in newtons and R² over transfers between different sensors, and self.

    Args:
        tokenizer: what is examined.
        training: hard training sets by sensor.
        draw: a recipe → sets by sensor.
        seeds: heads per cell.
        head: how heads are trained.
    """
    drawn = {
        (name, sensor): labelled
        for name, recipe in variants().items()
        for sensor, labelled in draw(recipe).items()
    }
    table = Table(
        training, {_key(*place): labelled for place, labelled in drawn.items()}, head or HeadTrainingConfig()
    )
    row = learnt_row(table, lambda s: encode_set(tokenizer, s), seeds, POOL)  # every head is trained once
    found: dict[str, Any] = {}
    for name in variants():
        cells = {
            (source, sensor): row[transfer_name(source, _key(name, sensor))]
            for source in training
            for variant, sensor in drawn
            if variant == name
        }
        found[name] = mean_cells(
            {
                "transfers": [cell for (source, target), cell in cells.items() if source != target],
                "self": [cell for (source, target), cell in cells.items() if source == target],
            }
        )
    return {"without": found, "oracle": oracle(HETERO_HARD), "sequences": SEQUENCES}


def _key(variant: str, sensor: str) -> str:
    return f"{sensor} without {variant}"


def oracle(recipe: HardSettings, draws: int = 20) -> dict[str, list[float]]:
    """Return the score of one who sees the force in the rubber times the unit's gain, best global scale allowed."""
    rng = np.random.default_rng([recipe.seed, 9])
    loads = [press_shear_release(rng, recipe.length, recipe.force_range) for _ in range(recipe.sequences)]
    truth, seen = [], []
    for _ in range(draws):
        for start in range(0, len(loads), recipe.sequences_per_unit):
            creep = Creep.draw(rng, recipe.creep_share)
            gain = 1 + rng.uniform(-0.1, 0.1) * recipe.unit_strength  # as UnitVariation.draw
            for load in loads[start : start + recipe.sequences_per_unit]:
                truth.append(load)
                seen.append(gain * lagging_force(load, creep, recipe.rate_hz))
    said, force = np.stack(seen), np.stack(truth)
    scale = (said * force).sum(axis=(0, 1)) / (said**2).sum(axis=(0, 1))
    return score(force, scale * said)


def draw_hardness(content: dict[str, Any], path: Path) -> Path:
    """Draw mean absolute errors of transfers and of sensors read by their own head."""
    names = list(content["without"])
    figure = Figure(figsize=(11, 4), layout="constrained")
    for axis, panel in enumerate(figure.subplots(1, 3)):
        for place, kind in enumerate(("transfers", "self")):
            mae_N = [content["without"][name][kind]["mae_N_paper_range"][axis] for name in names]
            panel.bar(np.arange(len(names)) + 0.4 * place - 0.2, mae_N, 0.4, label=kind)
        floor = content["oracle"]["mae_N_paper_range"][axis]
        panel.axhline(
            floor, color="black", linewidth=1, linestyle="--", label="oracle: gain and creep unknown"
        )
        panel.set_xticks(range(len(names)), names, rotation=40, ha="right")
        panel.set_title(f"{AXES[axis]}, N")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside lower center")
    figure.suptitle("Mean absolute error (0–12, ±3 N), simulated, by what was taken away from hetero_hard_v1")
    return save_figure(figure, path)
