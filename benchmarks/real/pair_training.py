"""Fine-tune the shipped tokenizer on real grasps beside simulated pairs: do both fingers of a real grasp read alike?

Objects are split into two halves by the hash of their names. Each half is read by the tokenizer that was trained on the
other one, so every object is new to the tokenizer that reads it. Training on simulated pairs alone, as long, is the
control.
"""

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.ledger import Ledger, update
from benchmarks.real.grasp_readers import described_reader, latent_reader, simulated_presses
from benchmarks.real.grasps import (
    SEALED,
    Grasp,
    Reader,
    Score,
    agreement,
    find_grasps,
    over_objects,
    read_grasp,
    summary,
)
from uniforce_cli.boundary import command, one_thread
from uniforce_datasets.readers.gelsight_grasps import read_grasps
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.options import Count, FolderPath, OutFile, OutFolder
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.pair_cache import NAMES, PairCache, Pairs, RecordedPairs, shrink
from uniforce_vtla.tokenizer.pretrain import Pretraining
from uniforce_vtla.tokenizer.settings import LossConfig, PairCacheConfig, PretrainSettings

CAMPAIGN = "close"  # few films of the wide one show free air: no reference, no force
UNITS = 4  # references in a batch
ARMS = {"simulated pairs": 0, "real and simulated pairs": UNITS // 2}  # real grasps among them
HALVES = (0, 1)
SIMULATED = PairCacheConfig(
    units=64,
    seed=3,
    family_share=0.6,
    free_look=True,
    marker_loss=0.02,
    flat_share=0.55,
    flat_torsion_arm_mm=9,
)
EQUILIBRIUM = LossConfig(equilibrium="levels", equilibrium_weight=600, equilibrium_warmup_steps=50)
PAIRS_PER_UNIT = 4
LEARNING_RATE = 3e-4
SHIPPED = "shipped"
DESCRIPTOR = "hand descriptor"


@dataclass
class PairTrainingCommand:
    """Fine-tune on halves of the real objects, read the other halves, compare with the shipped tokenizer.

    Run it again to go on.
    Example: python -m benchmarks.real.pair_training grasps=Incipient-Slip-Detection/docs/franka-servo/datasets
    """

    grasps: FolderPath = ""  # of two GelSight Minis; the sealed objects are left out
    seeds: Count = 3  # of training
    steps: Count = 450  # of fine-tuning
    work: OutFolder = "outputs/pair_training"  # grasps, tokenizers and readings so far
    out: OutFile = "outputs/real_pairs.json"  # only its key ``pair_training`` changes


class MixedPairs:
    """Training batches of which some units are real grasps and the others simulated."""

    def __init__(self, real: RecordedPairs, simulated: PairCache, real_units: int) -> None:
        self._real = real
        self._simulated = simulated
        self._real_units = real_units

    def draw(self, rng: np.random.Generator, units: int, pairs: int) -> Pairs:
        """Return ``units`` references with ``pairs`` contacts each."""
        simulated = self._simulated.draw(rng, units - self._real_units, pairs)
        if not self._real_units:
            return simulated
        real = self._real.draw(rng, self._real_units, pairs)
        joined = {
            name: torch.cat([getattr(real, name), getattr(simulated, name)]) for name in NAMES
        }
        return Pairs(**joined)


def half_of(held: str, objects: Sequence[str]) -> int:
    """Return which half an object is in: every other one in the order of the names' hashes."""
    by_hash = sorted(objects, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    return by_hash.index(held) % len(HALVES)


def shrunk(grasp: Grasp, side: int) -> dict[str, np.ndarray]:
    """Return a grasp's images by ``NAMES``: references (S, S), currents (n, S, S) uint8."""
    return {
        "left_reference": shrink(grasp.reference["left"][None], side)[0],
        "right_reference": shrink(grasp.reference["right"][None], side)[0],
        "left_current": shrink(grasp.current["left"], side),
        "right_current": shrink(grasp.current["right"], side),
    }


def tokenizers(
    config: PairTrainingCommand, grasps: Sequence[Grasp]
) -> dict[tuple[str, int, int], Tokenizer]:
    """Return (arm, seed, half that it may read) → tokenizer; one trained on simulated pairs may read both."""
    shipped = Tokenizer.from_pretrained()
    work = Path(config.work)
    simulated = PairCache(work / "simulated", SIMULATED)
    objects = sorted({grasp.held for grasp in grasps})
    images = [shrunk(grasp, shipped.config.side) for grasp in grasps]
    halves = [half_of(grasp.held, objects) for grasp in grasps]
    found: dict[tuple[str, int, int], Tokenizer] = {}
    for arm, real_units in ARMS.items():
        for seed in range(config.seeds):
            settings = PretrainSettings(
                model=shipped.config,
                loss=EQUILIBRIUM,
                data=SIMULATED,
                steps=config.steps,
                units_per_batch=UNITS,
                pairs_per_unit=PAIRS_PER_UNIT,
                learning_rate=LEARNING_RATE,
                warmup_steps=50,
                seed=seed,
                init="small",
                strips_every=0,
            )
            for half in HALVES:
                if half and not real_units:
                    found[arm, seed, half] = found[arm, seed, 0]
                    continue
                trained_on = [
                    of_grasp for of_grasp, own in zip(images, halves, strict=True) if own != half
                ]
                real = RecordedPairs(trained_on)
                folder = work / f"{arm}_{seed}_{half}".replace(" ", "_")
                data: Any = MixedPairs(real, simulated, real_units)
                found[arm, seed, half] = Pretraining(settings, folder, data).run()
    return found


def read_halves(config: PairTrainingCommand, grasps: Sequence[Grasp]) -> list[dict[str, Any]]:
    """Return a row per arm, seed and grasp, each read by a tokenizer that didn't see its object."""
    presses = simulated_presses(
        Tokenizer.from_pretrained().config.side, Path(config.work) / "labelled"
    )
    ledger = Ledger(Path(config.work))
    readers: dict[tuple[str, int, int], Reader] = {}
    shipped = latent_reader(Tokenizer.from_pretrained(), presses, 0)
    described = described_reader(presses, 0)
    for half in HALVES:
        readers[SHIPPED, 0, half] = shipped
        readers[DESCRIPTOR, 0, half] = described
    for key, tokenizer in tokenizers(config, grasps).items():
        readers[key] = latent_reader(tokenizer, presses, key[1])
    objects = sorted({grasp.held for grasp in grasps})
    done = {(row["arm"], row["seed"], row["half"]) for row in ledger.read("readings")}
    for (arm, seed, half), read in tqdm(readers.items(), desc="readers"):
        if (arm, seed, half) in done:
            continue
        own = [grasp for grasp in grasps if half_of(grasp.held, objects) == half]
        scores = [asdict(agreement(read_grasp(grasp, read))) for grasp in own]
        ledger.add("readings", {"arm": arm, "seed": seed, "half": half, "scores": scores})
    return ledger.read("readings")


def table(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return arm → agreement, spread of the trials' forces, and difference from the shipped tokenizer's error."""
    by_arm: dict[str, list[Score]] = {}
    for arm in (SHIPPED, DESCRIPTOR, *ARMS):
        seeds = sorted({row["seed"] for row in rows if row["arm"] == arm})
        by_seed = [_scores(rows, arm, seed) for seed in seeds]
        by_arm[arm] = [_mean(of_trial) for of_trial in zip(*by_seed, strict=True)]
    found: dict[str, Any] = {}
    for arm, scores in by_arm.items():
        found[arm] = summary(scores)
        mean_N = np.array([score.mean_N for score in scores])
        found[arm]["spread"] = float(mean_N.std() / np.abs(mean_N.mean()))
        found[arm]["minus_shipped_95"] = difference(scores, by_arm[SHIPPED])
    return found


def _scores(rows: Sequence[dict[str, Any]], arm: str, seed: int) -> list[Score]:
    """Return the scores of one arm and seed, trials in the same order for all."""
    own = sorted(
        (row for row in rows if row["arm"] == arm and row["seed"] == seed),
        key=lambda row: row["half"],
    )
    return [Score(**score) for row in own for score in row["scores"]]


def _mean(of_trial: Sequence[Score]) -> Score:
    """Return the mean over seeds of one trial's scores."""
    first = of_trial[0]
    error = float(np.mean([score.relative_error for score in of_trial]))
    r = float(np.mean([score.r for score in of_trial]))
    mean_N = float(np.mean([score.mean_N for score in of_trial]))
    return Score(first.held, first.group, first.frames, error, r, mean_N)


def difference(scores: Sequence[Score], others: Sequence[Score], seed: int = 0) -> list[float]:
    """Return the 95 % interval of the difference of median relative errors, paired by trial, over objects."""
    pairs = zip(scores, others, strict=True)
    errors = np.array([[own.relative_error, other.relative_error] for own, other in pairs])

    def apart(drawn: np.ndarray) -> list[float]:
        own, other = np.median(errors[drawn], axis=0)
        return [own - other]

    interval = over_objects([score.held for score in scores], apart, seed)  # (2, 1)
    return [float(bound) for bound in interval[:, 0]]


@command(PairTrainingCommand)
def main(config: PairTrainingCommand) -> None:
    """Train what is lacking, read what is lacking, write the table."""
    one_thread()
    trials = [trial for trial in read_grasps(config.grasps) if trial.campaign == CAMPAIGN]
    grasps = [grasp for grasp in find_grasps(trials) if grasp.held not in SEALED]
    objects = sorted({grasp.held for grasp in grasps})
    if len(objects) < 2 * len(HALVES):
        do = "Give docs/franka-servo/datasets of the whole repository."
        raise DatasetError(expected(f"objects of {config.grasps}", "four or more", objects, do))
    found = table(read_halves(config, grasps))
    for arm, line in found.items():
        low, high = line["minus_shipped_95"]
        print(
            f"{arm:26} relative error {line['relative_error']:.2f}, minus shipped [{low:+.2f}, {high:+.2f}]"
        )
    content = {"campaign": CAMPAIGN, "objects": objects, "trials": len(grasps), "arms": found}
    print(f"written to {update(Path(config.out), 'pair_training', content)}")


if __name__ == "__main__":
    sys.exit(main())
