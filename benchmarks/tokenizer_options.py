"""What each departure from the paper's objective buys: one option changed at a time, same seed, same steps."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from matplotlib.figure import Figure

from benchmarks.probes.report_sets import REPORT_SETS, get_report_set
from benchmarks.probes.zero_shot import POOL, Table, encode_set, learnt_row, summary, transfer_name
from benchmarks.tokenizer_report import draw_sets
from uniforce_cli.boundary import command
from uniforce_cli.pretrain import PRESETS, PretrainCommand
from uniforce_vtla.arguments import choose, read
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.options import Count, Names, OutFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig
from uniforce_vtla.tokenizer.pair_cache import FAMILY as RECIPE
from uniforce_vtla.tokenizer.pretrain import Pretraining, open_source

FAMILY = tuple(
    f"run.data.{name}={getattr(RECIPE, name)}"
    for name in ("family_share", "free_look", "marker_loss", "seed")
)
# All rows read by the heads this table began with: they compare with each other, not with the force tables' numbers.
HEADS = HeadTrainingConfig(input_noise=0.1)
BROKEN = ("run.data.imbalance=0.5", "run.data.misaligned_cells=2")  # pairs that no good bench delivers
VARIANTS: dict[str, tuple[str, ...]] = {
    "the nano recipe": (),
    "equilibrium as the paper's": ("run.loss.equilibrium=patch", "run.loss.equilibrium_scale=absolute"),
    "paper's four hundred times": (
        "run.loss.equilibrium=patch",
        "run.loss.equilibrium_scale=absolute",
        "run.loss.equilibrium_weight=400",
    ),
    "by patch alone": ("run.loss.equilibrium=patch",),
    "no weight on changed pixels": ("run.loss.changed_pixel_weight=0",),
    "decoder paints": ("run.model.warp=false",),
    "no motion channels": ("run.model.motion_scales=0",),
    "KL × 30": ("run.loss.kl_weight=0.3",),
    "material variables": ("run.model.material=4",),
    "procedural family": FAMILY,
    "a quarter of the units": ("run.data.units=192",),
    "latent of three": ("run.model.latent=3",),
    "latent of twelve": ("run.model.latent=12",),
    "patches of 32 px": ("run.model.patch=32",),
    "broken pairs": BROKEN,
    "broken pairs weighted by quality": (*BROKEN, "run.loss.pair_quality=2"),
}

LOWEST = -1.0  # R² is drawn down to here; a number says what lies below
PANELS = {
    "worst shear R²": "shear_worst",
    "mean shear R²": "shear_mean",
    "mean Fz R²": "fz_mean",
    "mean Fz error, N": "mae_fz_N",
}


Variants = Annotated[str, Names(tuple(VARIANTS), many=True)]
ReportSetName = Annotated[str, Names(tuple(REPORT_SETS))]


@dataclass
class OptionsCommand:
    """Train the nano recipe once per option and read force from it; a killed run continues with what is missing.

    Example: python -m benchmarks.tokenizer_options steps=800 only="latent of three,latent of twelve"
    """

    steps: Count = 800  # of each training; the shipped nano takes more
    set: ReportSetName = "hetero_hard_v1"  # frozen set that is read
    only: Variants = ""  # names of options (comma between them); empty = all
    out: OutFolder = "outputs/options"  # trainings and pair caches
    results: OutFolder = "outputs/options"  # pretraining_options.json and its figure
    cache: OutFolder = "outputs/labelled"  # drawn sets


def measure_variant(command: OptionsCommand, table: Table, overrides: tuple[str, ...]) -> dict[str, Any]:
    """Train one variant and return what the force table says of it (one head seed)."""
    pairs = "pairs_" + ("_".join(o.removeprefix("run.data.") for o in overrides if ".data." in o) or "nano")
    short = [f"run.steps={command.steps}", f"cache={command.out}/{pairs}", "preset=nano"]
    warmup = f"run.loss.equilibrium_warmup_steps={command.steps // 4}"
    variant, _ = read(PretrainCommand, [*short, warmup, *overrides], PRESETS)
    name = "_".join(_short(override) for override in overrides) or "nano"
    folder = Path(command.out) / name
    tokenizer = Pretraining(variant.run, folder, open_source(variant.run, Path(variant.cache))).run()
    row = learnt_row(table, lambda s: encode_set(tokenizer, s), 1, POOL)
    worst = np.min([row[transfer_name(a, b)]["r2"] for a, b in table.transfers()], axis=0)
    return {
        "overrides": list(overrides),
        "tokenizer_hash": tokenizer.hash,
        "summary": summary(row, table.transfers()),
        "worst_r2": worst.tolist(),
        "row": row,
    }


def _short(override: str) -> str:
    """Return ``run.loss.kl_weight=0.3`` as ``kl_weight-0.3``."""
    setting, _, value = override.partition("=")
    return f"{setting.rsplit('.', 1)[-1]}-{value}"


def _run(command: OptionsCommand) -> str:
    path = Path(command.results) / "pretraining_options.json"
    report_set = get_report_set(command.set)
    done: dict[str, Any] = {}
    if path.exists():
        before = json.loads(path.read_text())
        came, wanted = (before["set"], before["steps"]), (command.set, command.steps)
        if came != wanted:
            do = "Move it away, or ask for the same."
            raise ContractError(expected(str(path), wanted, came, do))
        done = before["options"]
    chosen = choose(VARIANTS, command.only)
    nano = read(PretrainCommand, ["preset=nano"], PRESETS)[0].run
    table = replace(draw_sets(report_set, nano.model.side, Path(command.cache)), head=HEADS)
    for name, overrides in chosen.items():
        if name in done:
            continue
        done[name] = measure_variant(command, table, overrides)
        what = "simulated; nano recipe, one option changed at a time, one seed, one head per source"
        content = {"what": what, "set": command.set, "steps": command.steps, "options": done}
        write_json(path, content | provenance())
    if done:
        draw_options(json.loads(path.read_text()), path.with_suffix(".png"))
    return "\n".join([*(_line(name, done[name]) for name in chosen), f"written to {path}"])


def draw_options(content: dict[str, Any], path: Path) -> Path:
    """Draw the options of ``tokenizer_options``, the best worst-shear cell on top; return the picture."""
    options = content["options"]
    names = sorted(options, key=lambda name: options[name]["summary"]["shear_worst"])
    figure = Figure(figsize=(13, 1.4 + 0.3 * len(names)), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharey=True)
    first = next(iter(options))  # the recipe the others differ from
    colours = ["#1f6fb2" if name == first else "0.65" for name in names]
    for panel, (title, key) in zip(panels, PANELS.items(), strict=True):
        values = np.array([options[name]["summary"][key] for name in names])
        shown = np.maximum(values, LOWEST)
        panel.barh(range(len(names)), shown, color=colours)
        for row, value in enumerate(values):
            panel.text(max(shown[row], 0) + 0.02, row, f"{value:.2f}", va="center", fontsize=7)
        panel.axvline(values[names.index(first)], color="#1f6fb2", lw=0.8, ls="--")
        panel.set_title(title)
        panel.margins(x=0.15)
    panels[0].set_yticks(range(len(names)), names)
    figure.suptitle(
        f"nano recipe, {content['steps']} steps, one option changed at a time ({content['set']}, simulated)"
    )
    return save_figure(figure, path)


def _line(name: str, found: dict[str, Any]) -> str:
    numbers = found["summary"]
    worst = " / ".join(f"{v:.2f}" for v in found["worst_r2"])
    return (
        f"{name:36s} mean R² {numbers['mean']:.2f}, shear {numbers['shear_mean']:.2f}, "
        f"Fz {numbers['fz_mean']:.2f}, worst {worst}"
    )


@command(OptionsCommand)
def main(config: OptionsCommand) -> int:
    """Entry of ``python -m benchmarks.tokenizer_options``."""
    logging.basicConfig(level=logging.INFO)
    torch.set_num_threads(1)
    print(_run(config))
    return 0


if __name__ == "__main__":
    sys.exit(main())
