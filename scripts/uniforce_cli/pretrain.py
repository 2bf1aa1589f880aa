"""Train the tokenizer on equilibrium pairs without force labels, then heads that read newtons."""

from __future__ import annotations

import logging
import resource
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tqdm import tqdm

import uniforce_vtla.tokenizer
from uniforce_cli.boundary import command
from uniforce_vtla.options import FileName, Names, OutFolder, Workers, split
from uniforce_vtla.results_file import only_writer
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.settings import PretrainSettings

if TYPE_CHECKING:
    from uniforce_vtla.tokenizer.pair_cache import PairCache, RecordedPairs

PRESETS = Path(uniforce_vtla.tokenizer.__file__).parent / "presets"  # one YAML file each
Heads = Annotated[str, Names((*list_sensors(), "none"), many=True)]


@dataclass
class PretrainCommand:
    """Draw simulated pairs once, or read recorded ones, then train.

    A killed run continues when started again. Without a preset the objective is the paper's, except
    for the defaults of the options below.

    Example: uniforce pretrain preset=nano out=outputs/mine run.steps=3000
    On your own sensors: uniforce pretrain preset=nano run.pairs=outputs/pairs/uniforce_pairs
    Then: uniforce view … tokenizer=outputs/mine/tokenizer
    and: uniforce train … policy.touch.tokenizer_path=outputs/mine/tokenizer
    """

    # settings of a shipped checkpoint: nano | small_draw and then small; further options win
    preset: FileName = ""
    run: PretrainSettings = field(default_factory=PretrainSettings)  # model, loss, data, optimiser
    # folder for drawn pairs, about 35 kB each; they are kept for the next run
    cache: OutFolder = "outputs/drawn_pairs"
    # sensors of the policy's demonstrations, comma between them; for each a force head is fitted to
    # 80 simulated units, in minutes
    heads: Heads = "tactip"
    # folder for state.safetensors to resume from, log.csv, tokenizer/ and force_head_SENSOR/
    out: OutFolder = "outputs/pretrain"
    threads: Workers = 1  # torch threads; a small model gains little from more


def recorded_pairs(folder: str, side: int) -> RecordedPairs:
    """Read the pairs that ``uniforce pairs`` recorded, shrunk to the model's side.

    Raises DatasetError: as ``read_uniforce_pairs``.
    """
    from uniforce_datasets.readers.uniforce_pairs import read_uniforce_pairs
    from uniforce_vtla.tokenizer.pair_cache import NAMES, RecordedPairs, shrink

    found = []
    recordings = read_uniforce_pairs(folder)
    first = next(recordings)  # a folder without pairs is refused before a bar is drawn
    for recording in tqdm(chain([first], recordings), desc="reading pairs", unit="grasp"):
        images = (
            shrink(recording.left_reference[None], side)[0],
            shrink(recording.right_reference[None], side)[0],
            shrink(recording.left_frames, side),
            shrink(recording.right_frames, side),
        )
        found.append(dict(zip(NAMES, images, strict=True)))
    return RecordedPairs(found)


@command(PretrainCommand, presets=PRESETS)
def main(settings: PretrainCommand) -> None:
    import torch

    from uniforce_vtla.tokenizer.force_head import ForceHead
    from uniforce_vtla.tokenizer.pair_cache import PairCache
    from uniforce_vtla.tokenizer.pretrain import Pretraining, starting_model
    from uniforce_vtla.tokenizer.worn_heads import fit_head

    logging.basicConfig(level=logging.INFO)
    torch.set_num_threads(settings.threads)
    starting_model(settings.run)  # refuses what does not fit before pairs are drawn
    data: PairCache | RecordedPairs
    if settings.run.pairs:
        data = recorded_pairs(settings.run.pairs, settings.run.model.side)
        unused = "nothing is drawn, run.data and cache are not used"
        print(f"training on pairs of {settings.run.pairs}: {unused}")
    else:
        data = PairCache(Path(settings.cache), settings.run.data)  # drawn where it isn't yet
    with only_writer(Path(settings.out) / "log.csv"):
        tokenizer = Pretraining(settings.run, Path(settings.out), data).run()
        for sensor in split(settings.heads):
            folder = Path(settings.out) / f"force_head_{sensor}"
            fitted_to = ""
            if folder.is_dir():
                fitted_to = ForceHead.from_pretrained(sensor, folder).tokenizer_hash
            if sensor != "none" and fitted_to != tokenizer.hash:
                fit_head(sensor, tokenizer).save(folder)
    peak_GB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # Linux counts in kB
    where = f"in {settings.out}/tokenizer, log in {settings.out}/log.csv"
    print(f"tokenizer {tokenizer.hash[:12]} {where}; peak memory {peak_GB:.1f} GB")
