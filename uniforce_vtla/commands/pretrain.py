"""Train the tokenizer on equilibrium pairs, without any force label."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path

import torch

from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.errors import UniForceError
from uniforce_vtla.tokenizer.pretrain import Pretraining, PretrainSettings, open_source


@dataclass
class PretrainCommand:
    """Draw the pairs once, then train; a killed run continues when started again.

    Example: uniforce-pretrain out=outputs/pretrain run.steps=3000 run.loss.equilibrium_weight=2
    """

    run: PretrainSettings = field(default_factory=PretrainSettings)  # model, loss, data, optimiser
    cache: str = "outputs/pairs"  # drawn pairs, about 35 kB each; kept for the next run
    out: str = "outputs/pretrain"  # state.pt to resume from, log.csv, tokenizer/ to load
    threads: int = 1  # torch threads; a small model gains little from more


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-pretrain``."""
    logging.basicConfig(level=logging.INFO)
    command = parse(PretrainCommand, argv)
    torch.set_num_threads(command.threads)
    try:
        data = open_source(command.run, Path(command.cache))
        tokenizer = Pretraining(command.run, Path(command.out), data).run()
    except UniForceError as error:
        print(f"pretrain: {error}")
        return 2
    print(f"tokenizer {tokenizer.hash[:12]} in {command.out}/tokenizer, log in {command.out}/log.csv")
    return 0
