"""Real recordings, read by the tokenizer, by an untrained one of its size and by hand descriptors."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real.grasps import balance, is_grasps
from benchmarks.real.readouts import (
    RIDGES,
    Features,
    descriptor_features,
    head_reading,
    labels_mm,
    latent_features,
    transfer,
)
from benchmarks.real.tactip_shear import TactipSet, is_tactip_shear, read_tactip_shear
from uniforce_cli.boundary import command
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.options import Count, FolderPaths, OutFile, TokenizerFolder, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

HEAD_SOURCES = {"grasps": "uskin", "tactip": "tactip"}


@dataclass
class RealCommand:
    """Read real recordings as their authors store them.

    TacTips with depth and shear labels: the first folder fits a linear readout, every other one is read with it.
    Example: python -m benchmarks.real data=cr_tactip/…/train_data,cr_tactip/…/val_data
    A folder of uSkin grasps (*/xela_sensor1.csv) gives the balance of both fingers. The recordings stay where they are.
    """

    data: FolderPaths = ""  # folders, comma between them
    tokenizer: TokenizerFolder = ""  # empty = the shipped one
    seeds: Count = 3  # untrained tokenizers
    frames: Count = 1000  # of each recording, at most
    out: OutFile = "outputs/real.json"


def tactip_rows(config: RealCommand, tokenizer: Tokenizer, sets: list[TactipSet]) -> dict[str, Any]:
    """Return target → row → ridge → scores, of readouts fitted on the first set."""
    untrained = [latent_features(Tokenizer.random(tokenizer.config, seed)) for seed in range(config.seeds)]
    rows: dict[str, list[Features]] = {
        "tokenizer": [latent_features(tokenizer)],
        "untrained": untrained,
        "descriptor": [descriptor_features],
    }
    found: dict[str, Any] = {s.name: {"reference": s.reference_from, "frames": len(s.current)} for s in sets}
    for name, makers in rows.items():
        seen = [[(make(s), labels_mm(s)) for s in sets] for make in makers]
        for number, target in enumerate(sets[1:], 1):
            found[target.name][name] = {
                str(ridge): [transfer(of[0], of[number], ridge) for of in seen] for ridge in RIDGES
            }
    head = ForceHead.from_pretrained(HEAD_SOURCES["tactip"], config.tokenizer or None)
    for target in sets:
        found[target.name]["head_nothing_fitted"] = head_reading(tokenizer, head, target)
    return found


def lines_of(found: dict[str, Any]) -> list[str]:
    """Return the page: one line per target, row and ridge; of untrained tokenizers the mean over seeds."""
    lines = [f"{'target':28} {'row':11} {'ridge':>6} | shear |r| as is, one angle, 10 frames | depth rank, 10 frames"]
    for target, rows in found.items():
        for name in ("tokenizer", "untrained", "descriptor"):
            for ridge, seeds in rows.get(name, {}).items():
                shear = [np.mean([s[w]["shear_r"] for s in seeds]) for w in ("as_is", "one_angle", "few_frames")]
                depth = [np.mean([s[w]["depth_rank"] for s in seeds]) for w in ("as_is", "few_frames")]
                numbers = " ".join(f"{v:.2f}" for v in shear) + " | " + " ".join(f"{v:.2f}" for v in depth)
                lines.append(f"{target:28} {name:11} {ridge:>6} | {numbers}")
    return lines


@command(RealCommand)
def main(config: RealCommand) -> None:
    folders = [Path(name) for name in split(config.data)]
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    labelled = [folder for folder in folders if is_tactip_shear(folder)]
    found: dict[str, Any] = {"what": "real recordings, read where they lie", "tokenizer_hash": tokenizer.hash}
    if labelled:
        found["tactip"] = tactip_rows(config, tokenizer, [read_tactip_shear(f, config.frames) for f in labelled])
        print("\n".join(lines_of(found["tactip"])))
    for folder in (f for f in folders if f not in labelled):
        found[folder.name] = _unlabelled(config, tokenizer, folder)
        print(folder.name, found[folder.name])
    print(f"written to {write_json(Path(config.out), found | provenance())}")


def _unlabelled(config: RealCommand, tokenizer: Tokenizer, folder: Path) -> dict[str, Any]:
    if is_grasps(folder):
        head = ForceHead.from_pretrained(HEAD_SOURCES["grasps"], config.tokenizer or None)
        return balance(tokenizer, head, folder)
    wanted = "targets_images.csv or */xela_sensor1.csv"
    raise DatasetError(expected(str(folder), wanted, "none of them", "Name the folder that holds them."))


if __name__ == "__main__":
    sys.exit(main())
