"""Is force read right where the contact model is another?  Zero-shot and calibrated, on finite elements."""

import json
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.finite_elements.calibrated import UnitGrasps, calibrated_cell, grasp
from benchmarks.finite_elements.sets import FE_CONTACTS, FE_DEV, units
from benchmarks.probes.report_sets import REPORT_SETS
from benchmarks.probes.zero_shot import (
    Cells,
    across,
    check_frozen,
    descriptor_row,
    encode_set,
    learnt_row,
    mean_row,
    score,
    transfer_name,
)
from benchmarks.tokenizer_report import draw_sets
from uniforce_cli.boundary import command
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import (
    Count,
    FilePath,
    FolderPath,
    Names,
    OutFile,
    OutFolder,
    TokenizerFolder,
)
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.latent import POOL

SETS = {settings.name: settings for settings in (FE_DEV, FE_CONTACTS)}
SetName = Annotated[str, Names(tuple(SETS))]


@dataclass
class OutsideCommand:
    """Score the shipped heads on contacts of finite elements, as they are and after label-free calibration.

    ``fe_dev_v1`` is for choosing, ``fe_contacts_v1`` for scoring once.
    Example: python -m benchmarks.finite_elements.outside set=fe_dev_v1 out=outputs/fe_dev.json
    """

    set: SetName = "fe_dev_v1"
    pairs: Count = 200  # grasps of a calibration, half small objects, half tools
    seeds: Count = 3  # of heads trained for the other rows, and of untrained encoders
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    facts: FolderPath = "docs/results"  # the frozen sets' recipes and hashes
    cache: OutFolder = "outputs/labelled"  # drawn sets; delete it after changing contact/
    real: FilePath = ""  # real.json of `benchmarks.real`: its summary stands beside
    contact: FilePath = ""  # contact_model.json of `benchmarks.finite_elements`, to stand beside
    out: OutFile = "outputs/outside.json"


def measure(config: OutsideCommand) -> dict[str, Any]:
    """Return rows by transfer; the shipped heads read, nothing is trained on finite elements."""
    report_set, tokenizer = (
        REPORT_SETS[config.set],
        Tokenizer.from_pretrained(config.tokenizer or None),
    )
    table = draw_sets(report_set, tokenizer.config.side, Path(config.cache))
    facts = json.loads((Path(config.facts) / report_set.facts_file).read_text())
    check_frozen(facts, table.frozen)
    rows: dict[str, Cells] = {"zero_shot": {}, "calibrated": {}}
    grasps = {name: _grasps(config, name) for name in table.frozen}
    for source, target in table.transfers():
        head, name = (
            ForceHead.from_pretrained(source, config.tokenizer or None),
            transfer_name(source, target),
        )
        frozen = table.frozen[target]
        each = head(encode_set(tokenizer, frozen).flatten(0, 1)).numpy()
        rows["zero_shot"][name] = score(frozen.force_N.reshape(-1, 3), each)
        sensors = as_virtual(target), as_virtual(source)
        rows["calibrated"][name] = calibrated_cell(tokenizer, head, sensors, grasps[target], frozen)
    for seed in range(config.seeds):
        untrained = partial(encode_set, Tokenizer.random(tokenizer.config, seed))
        rows[f"random encoder {seed}"] = learnt_row(table, untrained, 1, POOL)
    rows["hand descriptor"] = descriptor_row(table, config.seeds)
    rows["mean"] = mean_row(table)
    return {
        "set": facts["set"],
        "set_hash": facts["set_hash"],
        "tokenizer_hash": tokenizer.hash,
        **rows,
    }


def real_tactip(real: dict[str, Any]) -> dict[str, Any]:
    """Return what `benchmarks.real` found on the scored TacTip: |r| of shear and rank of depth, mean over ridges."""
    scored = next(found for found in real["tactip"].values() if "tokenizer" in found)

    def mean(encoder: str, form: str) -> dict[str, float]:
        cells = [cell[form] for cells in scored[encoder].values() for cell in cells]
        read = {"shear": "shear_r", "depth": "depth_rank"}
        return {name: float(np.mean([cell[key] for cell in cells])) for name, key in read.items()}

    return {
        "as_is": mean("tokenizer", "as_is"),
        "one_angle": mean("tokenizer", "one_angle"),
        "frames_10": mean("tokenizer", "few_frames"),
        "random_one_angle": mean("untrained", "one_angle"),
        "random_frames_10": mean("untrained", "few_frames"),
    } | {key: real[key] for key in ("command", "date", "tokenizer_hash")}


def beside(real: str, contact: str) -> dict[str, Any]:
    """Return the sections of other commands' results that stand in the same file."""
    found = {"real_tactip": real_tactip(read_object(Path(real), DatasetError))} if real else {}
    return found | (
        {"contact_model": read_object(Path(contact), DatasetError)["contact_model"]}
        if contact
        else {}
    )


def _grasps(config: OutsideCommand, sensor: str) -> list[UnitGrasps]:
    worn = units(SETS[config.set], as_virtual(sensor))
    bar = tqdm(worn, desc=f"grasps of {sensor}")
    return [grasp(unit, number, config.pairs) for number, unit in enumerate(bar)]


def summary(row: Cells) -> str:
    """Return the row's line: mean and worst over transfers between different sensors."""
    r2, r = across(row, "r2"), across(row, "abs_r")
    line = (
        f"R² Fz {r2[:, 2].mean():.2f} (worst {r2[:, 2].min():.2f}), shear {r2[:, :2].mean():.2f}; "
    )
    line += f"|r| Fz {r[:, 2].mean():.2f}, shear {r[:, :2].mean():.2f}"
    if "slope" in next(iter(row.values())):
        line += f"; slope shear {across(row, 'slope')[:, :2].mean():.2f}"
    return line


@command(OutsideCommand)
def main(config: OutsideCommand) -> None:
    torch.set_num_threads(1)
    content = measure(config)
    for name, row in content.items():
        if isinstance(row, dict):
            print(f"{name:18} {summary(row)}")
    path = Path(config.out)
    found = json.loads(path.read_text()) if path.is_file() else {}
    found |= {config.set: content | provenance()} | beside(config.real, config.contact)
    print(f"written to {write_json(path, found)}")


if __name__ == "__main__":
    sys.exit(main())
