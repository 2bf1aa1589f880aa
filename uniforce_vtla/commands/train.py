"""Train a policy with LeRobot's own trainer, in ``key=value`` form and with this project's data views."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lerobot.datasets import factory
from lerobot.scripts import lerobot_train
from lerobot.utils.import_utils import register_third_party_plugins

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import VIEW_MARKER

HELP = """\
Train a policy with LeRobot's trainer; everything after the script's name is a setting of lerobot-train.

  python scripts/train.py policy=pi05_uniforce dataset.repo_id=local/wipe dataset.root=outputs/wipe \\
      output_dir=outputs/train steps=3000 batch_size=32

  policy=NAME            becomes --policy.type=NAME; policy.size=tiny|base chooses the size (tiny without CUDA)
  policy.touch_slots="{touch0: right, touch1: left}"   which finger fills which touch slot; {} or
  policy.touch_input=none                              trains without touch
  resume=true config_path=outputs/train/checkpoints/last/pretrained_model/train_config.json
  more: lerobot-train --help (run with --policy.type=pi05_uniforce to see this policy's settings)

Added unless given: policy.push_to_hub=false, wandb.enable=false.  A dataset root that holds a training view
(uniforce_view.json: cached latents, small images) is read through it, many times faster than video.
"""

CHOICES = ("policy", "env")  # LeRobot wants --policy.type=NAME
DEFAULTS = {"policy.push_to_hub": "false", "wandb.enable": "false"}


def to_lerobot(argv: Sequence[str]) -> list[str]:
    """Turn ``policy=NAME k=v`` into ``--policy.type=NAME --k=v`` and add the defaults not given."""
    flags = [_flag(argument) for argument in argv]
    given = {flag[2:].partition("=")[0] for flag in flags if flag.startswith("--")}
    if "resume" in given:  # a resumed run brings its own settings
        return flags
    return flags + [f"--{key}={value}" for key, value in DEFAULTS.items() if key not in given]


def _flag(argument: str) -> str:
    if argument.startswith("-") or "=" not in argument:
        return argument
    key, _, value = argument.partition("=")
    return f"--{key}.type={value}" if key in CHOICES else f"--{key}={value}"


@contextmanager
def training_views() -> Iterator[None]:
    """Let LeRobot's trainer read a training view where the dataset root holds one; other roots stay stock."""
    stock = factory.make_dataset

    def make_dataset(cfg: Any) -> Any:
        root = cfg.dataset.root
        if root is None or not (Path(root) / VIEW_MARKER).is_file():
            return stock(cfg)
        if cfg.dataset.eval_split:
            do = "Make a view of the held-out episodes instead."
            raise ContractError(
                expected("dataset.eval_split", "0 with a training view", cfg.dataset.eval_split, do)
            )
        from uniforce_datasets.training_view import make_training_dataset  # pulls in the recorder's libraries

        return make_training_dataset(cfg, stock)

    factory.make_dataset = make_dataset
    try:
        yield
    finally:
        factory.make_dataset = stock


def main(argv: Sequence[str] | None = None) -> None:
    """Run ``lerobot-train`` on the given arguments (the process's own when None)."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments in (["--help"], ["-h"]):
        print(HELP)
        return
    register_third_party_plugins()
    before, sys.argv = (
        sys.argv,
        [sys.argv[0], *to_lerobot(arguments)],
    )  # LeRobot's parser reads sys.argv itself
    try:
        with training_views():
            lerobot_train.main()
    finally:
        sys.argv = before


if __name__ == "__main__":
    main()
