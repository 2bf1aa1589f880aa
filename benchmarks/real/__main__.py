"""Real recordings, read by the tokenizer, by an untrained one and by hand descriptors."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from benchmarks.real.eflesh import eflesh_lines, eflesh_rows
from benchmarks.real.gelsight_grasps import read_grasps
from benchmarks.real.grasp_readers import grasp_readers
from benchmarks.real.grasps import SEALED, SEEN, by_group, find_grasps, read_grasps_by
from benchmarks.real.readouts import (
    RIDGES,
    Features,
    descriptor_features,
    head_reading,
    labels_mm,
    latent_features,
    transfer,
)
from benchmarks.real.tactip_shear import TactipSet, read_tactip_shear
from benchmarks.real.uskin_grasps import SENSOR as USKIN
from benchmarks.real.uskin_grasps import find_uskin_grasps
from uniforce_cli.boundary import command
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.options import (
    Count,
    FolderPath,
    FolderPaths,
    Names,
    OutFile,
    OutFolder,
    TokenizerFolder,
    split,
)
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

SETS = ("seen", "development", "sealed")
Objects = Annotated[str, Names(SETS, many=True)]


@dataclass
class RealCommand:
    """Read real recordings as their authors store them; the recordings stay where they are.

    TacTips with depth and shear labels: the first folder fits a readout, others are read by it.
    Example: python -m benchmarks.real data=cr_tactip/…/train_data,cr_tactip/…/val_data
    Grasps of two GelSight Minis: how well the normal forces of both fingers agree.
    Example: python -m benchmarks.real grasps=Incipient-Slip-Detection/docs/franka-servo/datasets
    Grasps of two uSkins: the same.
    Example: python -m benchmarks.real uskin=proactive-slip-control/data_set
    Two units of a magnetic skin, with newtons: a unit's own readout, and the other unit's.
    Example: python -m benchmarks.real eflesh=eFlesh/characterization/datasets
    """

    data: FolderPaths = ""  # of TacTips, comma between them
    grasps: FolderPath = ""  # of two GelSight Minis
    uskin: FolderPath = ""  # grasps of two uSkins
    eflesh: FolderPath = ""  # of the magnetic skin
    # of grasps and skin, comma between them: seen, by a trial once | development, all others but
    # the sealed | sealed: score them once
    objects: Objects = "development"
    borrow: bool = False  # of the grasps: references of other films where one shows contact only
    tokenizer: TokenizerFolder = ""  # empty = the shipped one
    seeds: Count = 3  # untrained tokenizers
    frames: Count = 1000  # of each recording, at most
    cache: OutFolder = "outputs/labelled"  # simulated presses that the grasps' heads learn from
    out: OutFile = "outputs/real.json"


def tactip_rows(config: RealCommand, tokenizer: Tokenizer, sets: list[TactipSet]) -> dict[str, Any]:
    """Return target → row → ridge → scores, of readouts fitted on the first set."""
    untrained = []
    for seed in range(config.seeds):
        untrained.append(latent_features(Tokenizer.random(tokenizer.config, seed)))
    rows: dict[str, list[Features]] = {
        "tokenizer": [latent_features(tokenizer)],
        "untrained": untrained,
        "descriptor": [descriptor_features],
    }
    found: dict[str, Any] = {}
    for one in sets:
        found[one.name] = {"reference": one.reference_from, "frames": len(one.current)}
    for name, makers in rows.items():
        seen = [[(features(one), labels_mm(one)) for one in sets] for features in makers]
        for number, target in enumerate(sets[1:], 1):
            by_ridge = {}
            for ridge in RIDGES:
                by_ridge[str(ridge)] = [transfer(of[0], of[number], ridge) for of in seen]
            found[target.name][name] = by_ridge
    head = ForceHead.from_pretrained("tactip", config.tokenizer or None)
    for target in sets:
        found[target.name]["head_nothing_fitted"] = head_reading(tokenizer, head, target)
    return found


def tactip_lines(found: dict[str, Any]) -> list[str]:
    """Return a line per target, row and ridge; of untrained tokenizers the mean over seeds."""
    lines = [
        f"{'target':28} {'row':11} {'ridge':>6} | shear |r| as is, one angle, 10 frames | "
        "depth rank, 10 frames"
    ]
    for target, rows in found.items():
        for name in ("tokenizer", "untrained", "descriptor"):
            for ridge, seeds in rows.get(name, {}).items():
                line = f"{target:28} {name:11} {ridge:>6} |"
                for way in ("as_is", "one_angle", "few_frames"):
                    line += f" {np.mean([one[way]['shear_r'] for one in seeds]):.2f}"
                line += " |"
                for way in ("as_is", "few_frames"):
                    line += f" {np.mean([one[way]['depth_rank'] for one in seeds]):.2f}"
                lines.append(line)
    return lines


def grasp_rows(config: RealCommand, tokenizer: Tokenizer) -> dict[str, Any]:
    """Return set of objects → reader → group of trials → agreement of the fingers."""
    trials = read_grasps(config.grasps)
    wanted = split(config.objects)
    named = {trial.object_name for trial in trials if set_of(trial.object_name) in wanted}
    if not named:
        do = "Give docs/franka-servo/datasets of the whole repository."
        raise DatasetError(
            expected(f"objects of {config.grasps}", config.objects, "none of them", do)
        )
    # trials of all objects serve to find free frames
    grasps = (grasp for grasp in find_grasps(trials, config.borrow) if grasp.held in named)
    readings = read_grasps_by(grasps, grasp_readers(tokenizer, 0, Path(config.cache)))
    found: dict[str, Any] = {}
    for name in wanted:
        found[name] = {}
        for reader, of_reader in readings.items():
            own = [reading for reading in of_reader if set_of(reading.held) == name]
            found[name][reader] = by_group(own)
    return found


def set_of(held: str) -> str:
    """Return which of ``SETS`` an object belongs to."""
    if held in SEALED:
        return "sealed"
    return "seen" if held in SEEN else "development"


def uskin_rows(config: RealCommand, tokenizer: Tokenizer) -> dict[str, Any]:
    """Return reader → group of trials → agreement of the fingers."""
    readers = grasp_readers(tokenizer, 0, Path(config.cache), USKIN)
    readings = read_grasps_by(find_uskin_grasps(config.uskin), readers)
    return {name: by_group(of_reader) for name, of_reader in readings.items()}


def grasp_lines(found: dict[str, Any]) -> list[str]:
    """Return a line per reader and group."""
    lines = []
    for name, groups in found.items():
        for group, row in groups.items():
            line = f"{name:24} {group:16} {row['trials']} trials of {row['objects']} objects:"
            for key, words in (("relative_error", "relative error"), ("r", "r")):
                low, high = row[f"{key}_95"]
                line += f" {words} {row[key]:.2f} [{low:.2f}, {high:.2f}]"
            lines.append(line)
    return lines


@command(RealCommand)
def main(config: RealCommand) -> None:
    folders = [Path(name) for name in split(config.data)]
    if not folders and not config.grasps and not config.uskin and not config.eflesh:
        raise ContractError(
            expected("data", "folders of recordings", "none", "Name those that fit and are read.")
        )
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    content: dict[str, Any] = {
        "what": "real recordings, read where they lie",
        "tokenizer_hash": tokenizer.hash,
    }
    lines = []
    if folders:
        sets = [read_tactip_shear(folder, config.frames) for folder in folders]
        content["tactip"] = tactip_rows(config, tokenizer, sets)
        lines += tactip_lines(content["tactip"])
    if config.grasps:
        content["grasps"] = grasp_rows(config, tokenizer)
        for name, found in content["grasps"].items():
            lines += [name, *grasp_lines(found)]
    if config.uskin:
        content["uskin"] = uskin_rows(config, tokenizer)
        lines += grasp_lines(content["uskin"])
    if config.eflesh:
        sealed = "sealed" in split(config.objects)
        content["eflesh"] = eflesh_rows(
            Path(config.eflesh), tokenizer, config.seeds, config.frames, sealed
        )
        lines += eflesh_lines(content["eflesh"])
    print("\n".join(lines))
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
