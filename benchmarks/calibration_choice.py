"""The chosen calibration beside none, one gain and the map, on grasps without part in the choice.

Simulated units grasp beside a TacTip. Real grasps are of two GelSight Minis, either finger read
against the other: by normal force alone, since a freely pinched object shears the fingers opposite
ways. They judge in five parts: once by trial, and once by object, which is harder, since trials of
one object resemble each other.
"""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.real.gelsight_grasps import read_grasps
from benchmarks.real.grasp_readers import encode_in_batches
from benchmarks.real.grasps import SEALED, SEEN, find_grasps
from uniforce_cli.boundary import command, one_thread
from uniforce_cli.calibrate import Unit
from uniforce_cli.paired_grasps import simulated_grasps
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.options import Count, FolderPath, OutFile, Seed, Text, TokenizerFolder, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibration_choice import (
    AXES,
    FORMS,
    choose_form,
    error_of_grasps,
    fit_form,
    newtons,
)
from uniforce_vtla.tokenizer.latent_map import FOLDS, folds, grasp_numbers

NORMAL = (2,)  # axis


@dataclass
class ChoiceCommand:
    """Compare the forms of a calibration on left-out grasps.

    Example: python -m benchmarks.calibration_choice real=…/docs/franka-servo/datasets
    """

    # simulated units; those numbered 2 and 3 were used to choose the rule
    new: Text = "gelsight:4,gelsight:5,uskin:4,uskin:5,tactip:4,tactip:5"
    anchor: Unit = "tactip"  # its head reads the simulated grasps
    grasps: Count = 300  # simulated, of each unit; as many more judge
    real: FolderPath = ""  # grasps of two GelSight Minis; empty = left out
    tokenizer: TokenizerFolder = ""  # empty = the shipped one
    seed: Seed = 0  # of the simulated grasps
    out: OutFile = "outputs/calibration_choice.json"


@dataclass(frozen=True)
class Case:
    """Latents (n, P, L) of both fingers on the same grasps, and which of them judge.

    Rows with the same part, 0 or above, judge together and are calibrated by all others; rows of
    part -1 never judge.
    """

    new: torch.Tensor
    anchor: torch.Tensor
    grasps: np.ndarray  # (n,) number of the grasp
    parts: np.ndarray  # (n,)
    head: ForceHead
    axes: Sequence[int]


def compare(case: Case) -> dict[str, Any]:
    """Return the error of each form and of the chosen one, and the choice for each part."""
    known = newtons(case.head, case.anchor)
    read = {form: np.zeros_like(known) for form in (*FORMS, "chosen")}
    choices = []
    for part in range(case.parts.max() + 1):
        judge = np.flatnonzero(case.parts == part)
        fit = np.flatnonzero(case.parts != part)
        new = case.new[fit]
        anchor = case.anchor[fit]
        for form in FORMS:
            latent_map, _ = fit_form(form, new, anchor, case.grasps[fit])
            read[form][judge] = newtons(case.head, latent_map(case.new[judge]))
        choices.append(choose_form(new, anchor, case.head, case.grasps[fit], case.axes))
        read["chosen"][judge] = read[choices[-1].form][judge]
    rows = np.flatnonzero(case.parts >= 0)
    grasps = grasp_numbers(case.grasps[rows], len(rows))
    error = {}
    for form, of_form in read.items():
        of_grasps = error_of_grasps(of_form[rows], known[rows], grasps, case.axes)
        error[form] = float(of_grasps.mean())
    return {
        "grasps": int(grasps.max()) + 1,
        "error": error,
        "never_worse": error["chosen"] <= error["none"],
        "choices": [asdict(choice) for choice in choices],
    }


def simulated_case(config: ChoiceCommand, new: str, tokenizer: Tokenizer, head: ForceHead) -> Case:
    """Return simulated grasps of a unit beside the anchor: the second half judges."""
    found = simulated_grasps(new, config.anchor, 2 * config.grasps, config.seed, tokenizer.pooled)
    of_new = found.new.as_subclass(torch.Tensor)
    of_anchor = found.anchor.as_subclass(torch.Tensor)
    numbers = np.array(found.numbers)
    return Case(of_new, of_anchor, numbers, np.where(numbers < config.grasps, -1, 0), head, AXES)


def real_cases(folder: str, tokenizer: Tokenizer, head: ForceHead) -> dict[str, Case]:
    """Return the development objects' grasps, by campaign, finger and what is left out together."""
    encode = encode_in_batches(tokenizer)
    campaigns: dict[str, list[tuple[str, dict[Finger, torch.Tensor]]]] = {}
    for grasp in tqdm(find_grasps(read_grasps(folder)), desc="grasps", unit="grasp"):
        if grasp.held not in {*SEEN, *SEALED}:
            latents = {}
            for finger in FINGERS:
                latents[finger] = encode(grasp.reference[finger], grasp.current[finger], finger)
            campaigns.setdefault(grasp.group, []).append((grasp.held, latents))
    cases = {}
    for campaign, grasps in campaigns.items():
        if len(grasps) < FOLDS:
            print(f"GelSight Mini {campaign}: left out, {len(grasps)} grasps are too few")
            continue
        held = [name for name, _ in grasps]
        frames = [len(latents["left"]) for _, latents in grasps]
        left = torch.cat([latents["left"] for _, latents in grasps])
        right = torch.cat([latents["right"] for _, latents in grasps])
        alike = {"trial": np.arange(len(held)), "object": np.unique(held, return_inverse=True)[1]}
        for unit, numbers in alike.items():
            rows = np.repeat(numbers, frames)
            for finger, new, anchor in (("left", left, right), ("right", right, left)):
                name = f"GelSight Mini {campaign}, {finger} finger, a left-out {unit}"
                cases[name] = Case(new, anchor, rows, folds(rows), head, NORMAL)
    return cases


@command(ChoiceCommand)
def main(config: ChoiceCommand) -> None:
    one_thread()
    folder = config.tokenizer or None
    tokenizer = Tokenizer.from_pretrained(folder)
    anchor_head = ForceHead.from_pretrained(config.anchor.partition(":")[0], folder)
    found = {}
    for new in split(config.new):
        found[f"simulated {new}"] = compare(simulated_case(config, new, tokenizer, anchor_head))
        print(line(f"simulated {new}", found[f"simulated {new}"]), flush=True)
    if config.real:
        head = ForceHead.from_pretrained("gelsight", folder)
        for name, case in real_cases(config.real, tokenizer, head).items():
            found[name] = compare(case)
            print(line(name, found[name]), flush=True)
    else:
        print("real grasps: left out, real= names no folder")
    never = sum(row["never_worse"] for row in found.values())
    content = {
        "what": "squared difference of newtons in units of the anchor's variance, "
        "on grasps without part in fit and choice",
        "cases": found,
        "never_worse_than_none": never,
        "of": len(found),
        "tokenizer_hash": tokenizer.hash,
    }
    where = write_json(Path(config.out), content | provenance())
    print(f"never worse than none: {never} of {len(found)}; written to {where}")


def line(name: str, row: dict[str, Any]) -> str:
    """Return one case in words."""
    errors = ", ".join(f"{form} {error:.3f}" for form, error in row["error"].items())
    forms = " ".join(choice["form"] for choice in row["choices"])
    return f"{name:54} {row['grasps']:3d} judge: {errors} ({forms})"


if __name__ == "__main__":
    sys.exit(main())
