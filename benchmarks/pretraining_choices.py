"""Worth of each choice of the pretraining: short runs, one choice changed at a time, on development sets."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.probes.report_sets import REPORT_SETS
from benchmarks.probes.zero_shot import across, check_frozen, encode_set, learnt_row
from benchmarks.real.readouts import RIDGES, head_reading, labels_mm, latent_features, transfer
from benchmarks.real.tactip_shear import TactipSet, read_tactip_shear
from benchmarks.tokenizer_report import draw_sets
from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.errors import ContractError, require_one_of
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Count, FolderPath, FolderPaths, OutFile, OutFolder, Text, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead, HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.latent import POOL
from uniforce_vtla.tokenizer.pair_cache import PairCache
from uniforce_vtla.tokenizer.pretrain import Pretraining
from uniforce_vtla.tokenizer.settings import (
    LossConfig,
    PairCacheConfig,
    PretrainSettings,
    TokenizerConfig,
)

SET = "fe_dev_v1"
FULL = PairCacheConfig(
    family_share=0.6, free_look=True, marker_loss=0.02, flat_share=0.35, flat_torsion_arm_mm=9
)
PER_UNIT = LossConfig(
    equilibrium="levels",
    equilibrium_scale="per_unit",
    equilibrium_weight=20,
    equilibrium_warmup_steps=600,
)
ABSOLUTE = replace(PER_UNIT, equilibrium_scale="absolute", equilibrium_weight=600)
CHOICES: dict[str, tuple[PairCacheConfig, LossConfig]] = {
    "all": (FULL, PER_UNIT),
    "no procedural family": (replace(FULL, family_share=0.0), PER_UNIT),
    "no held tools": (replace(FULL, flat_share=0.0), PER_UNIT),
    "latent's own unit": (FULL, ABSOLUTE),
    "patches alone": (FULL, replace(PER_UNIT, equilibrium="patch")),
    # equilibrium broken while pairs are collected
    "fingers 1.25 mm apart": (replace(FULL, misaligned_cells=1), ABSOLUTE),
    "fingers 3.75 mm apart": (replace(FULL, misaligned_cells=3), ABSOLUTE),
    "forces 10 % apart": (replace(FULL, imbalance=0.1), ABSOLUTE),
    "forces 30 % apart": (replace(FULL, imbalance=0.3), ABSOLUTE),
}


@dataclass
class PretrainingChoicesCommand:
    """Pretrain a small tokenizer per choice and seed; score zero-shot force on finite elements and on real TacTips.

    Run it again to go on.
    Example: python -m benchmarks.pretraining_choices real=cr_tactip/…/train_data,cr_tactip/…/val_data
    """

    # two folders of one real TacTip: a readout is fitted on the first, scored on the second
    real: FolderPaths = ""
    choices: Text = ""  # names, comma between them; "" = all
    seeds: Count = 3
    steps: Count = 1500  # of each run; nano itself takes 2,600
    units: Count = 512  # per rig
    frames: Count = 300  # of each real folder, at most
    facts: FolderPath = "docs/results"  # the frozen set's recipe and hash
    cache: OutFolder = "outputs/labelled"  # drawn sets
    work: OutFolder = "outputs/pretraining_choices"  # pairs and runs
    out: OutFile = "outputs/pretraining_choices.json"


def frozen_facts(config: PretrainingChoicesCommand) -> dict[str, Any]:
    """Return recipe and hash of the set that is scored; ContractError: no such file."""
    return read_object(Path(config.facts) / REPORT_SETS[SET].facts_file, ContractError)


def pretrained(config: PretrainingChoicesCommand, name: str, seed: int) -> Tokenizer:
    """Return the tokenizer of one run, trained where it isn't yet."""
    data, loss = CHOICES[name]
    data = replace(data, units=config.units)
    work, slug = Path(config.work), name.replace(" ", "_").replace("'", "").replace("%", "percent")
    pairs = f"pairs_{data.family_share}_{data.flat_share}"  # shared by choices that draw alike
    if data.misaligned_cells or data.imbalance:
        pairs += f"_{data.misaligned_cells}_{data.imbalance}"
    model = TokenizerConfig(width=64, embed_hidden=128, warp=True)
    settings = PretrainSettings(model, loss, data, steps=config.steps, seed=seed, strips_every=0)
    return Pretraining(
        settings, work / f"{slug}_{seed}", PairCache(work / pairs, settings.data)
    ).run()


def measure(
    config: PretrainingChoicesCommand,
    tokenizer: Tokenizer,
    seed: int,
    real: list[TactipSet],
    facts: dict[str, Any],
) -> dict:
    table = draw_sets(REPORT_SETS[SET], tokenizer.config.side, Path(config.cache))
    check_frozen(facts, table.frozen)
    row = learnt_row(table, lambda s: encode_set(tokenizer, s), 1, POOL)
    r2, r = across(row, "r2"), across(row, "abs_r")
    found: dict[str, Any] = {
        "fz_r2": r2[:, 2].mean(),
        "fz_r2_worst": r2[:, 2].min(),
        "fz_r": r[:, 2].mean(),
        "shear_r2": r2[:, :2].mean(),
        "shear_r": r[:, :2].mean(),
    }
    if real:
        labelled = table.training["tactip"]
        model = train_head(
            encode_set(tokenizer, labelled), labelled.force_N, HeadTrainingConfig(), seed
        )
        nothing_fitted = head_reading(
            tokenizer, ForceHead(model, "tactip", tokenizer.hash), real[1]
        )
        found["real_head_shear_r"] = nothing_fitted["shear_r"]
        found["real_head_depth_rank"] = nothing_fitted["depth_rank"]
        features = latent_features(tokenizer)
        fitted_on, scored_on = ((features(s), labels_mm(s)) for s in real)
        read = [transfer(fitted_on, scored_on, ridge)["as_is"] for ridge in RIDGES]
        found["real_readout_shear_r"] = np.mean([one["shear_r"] for one in read])
    return {key: round(float(value), 4) for key, value in found.items()}


@command(PretrainingChoicesCommand)
def main(config: PretrainingChoicesCommand) -> None:
    one_thread()
    torch.set_num_threads(1)
    path = Path(config.out)
    found = json.loads(path.read_text())["runs"] if path.is_file() else {}
    real = [read_tactip_shear(Path(folder), config.frames) for folder in split(config.real)]
    frozen = frozen_facts(config)
    names = split(config.choices) or list(CHOICES)
    for name in names:
        require_one_of("choice", name, list(CHOICES))
    runs = [
        (name, seed)
        for seed in range(config.seeds)
        for name in names
        if f"{name}, seed {seed}" not in found
    ]
    for name, seed in tqdm(runs, desc="runs"):
        found[f"{name}, seed {seed}"] = measure(
            config, pretrained(config, name, seed), seed, real, frozen
        )
        facts = {"set": SET, "steps": config.steps, "units": config.units, "runs": found}
        write_json(path, facts | provenance())
    for name in names:
        own = [row for key, row in found.items() if key.startswith(f"{name}, ")]
        print(name, "  ".join(f"{key} {np.mean([row[key] for row in own]):.2f}" for key in own[0]))


if __name__ == "__main__":
    sys.exit(main())
