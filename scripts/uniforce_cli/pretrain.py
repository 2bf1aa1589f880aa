"""Train the tokenizer on equilibrium pairs, without any force label."""

import logging
import resource
from dataclasses import dataclass, field
from pathlib import Path

import uniforce_vtla.tokenizer
from uniforce_cli.boundary import command
from uniforce_vtla.options import FileName, OutFolder, Workers
from uniforce_vtla.tokenizer.settings import PretrainSettings

PRESETS = Path(uniforce_vtla.tokenizer.__file__).parent / "presets"  # one YAML file each


@dataclass
class PretrainCommand:
    """Draw the pairs once, then train; a killed run continues when started again.

    Without a preset the objective is the paper's but for the options' defaults named below.

    Example: uniforce pretrain preset=nano out=outputs/mine run.steps=3000
    """

    preset: FileName = ""  # nano | small_draw and then small: the shipped checkpoints; what else you give wins
    run: PretrainSettings = field(default_factory=PretrainSettings)  # model, loss, data, optimiser
    cache: OutFolder = "outputs/pairs"  # drawn pairs, about 35 kB each; kept for the next run
    out: OutFolder = "outputs/pretrain"  # state.safetensors to resume from, log.csv, tokenizer/ to load
    threads: Workers = 1  # torch threads; a small model gains little from more


@command(PretrainCommand, presets=PRESETS)
def main(settings: PretrainCommand) -> None:
    import torch

    from uniforce_vtla.tokenizer.pair_cache import PairCache
    from uniforce_vtla.tokenizer.pretrain import Pretraining, starting_model

    logging.basicConfig(level=logging.INFO)
    torch.set_num_threads(settings.threads)
    starting_model(settings.run)  # refuses what does not fit before pairs are drawn
    data = PairCache(Path(settings.cache), settings.run.data)  # drawn where it isn't yet
    tokenizer = Pretraining(settings.run, Path(settings.out), data).run()
    peak_GB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # Linux counts in kB
    where = f"in {settings.out}/tokenizer, log in {settings.out}/log.csv"
    print(f"tokenizer {tokenizer.hash[:12]} {where}; peak memory {peak_GB:.1f} GB")
