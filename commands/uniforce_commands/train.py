"""Train a policy with LeRobot's own trainer, in ``key=value`` form and with this project's data views."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from accelerate import PartialState, utils
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
  policy.recipe=scored   train as the benchmark's arms were trained; without it: latents, nothing else
  policy.touch.slots="{touch0: right, touch1: left}"   which finger fills which touch slot; {} or
  policy.touch.input=none                              trains without touch
  resume=true config_path=outputs/train/checkpoints/last/pretrained_model/train_config.json
  policy.train_expert_only=true | policy.freeze_vision_encoder=true | --peft.method_type=LORA   train less
  policy.touch.next_force_weight=0.1   also predict the latents when the next chunk begins (training views only)
  accelerate launch --num_processes=4 scripts/train.py …   several devices; no search for unused parameters
  more: lerobot-train --help (run with --policy.type=pi05_uniforce to see this policy's settings)

Added unless given: policy.push_to_hub=false, wandb.enable=false.  A dataset root that holds a training view
(uniforce_view.json: cached latents, small images) is read through it, many times faster than video.
"""

CHOICES = ("policy", "env")  # LeRobot wants --policy.type=NAME
OURS = "pi05_uniforce"
DEFAULTS = {"policy.push_to_hub": "false", "wandb.enable": "false"}
KEPT_GROUPS: list[Any] = []  # process groups of trainings that ended, see ``process_group_kept``


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


@contextmanager
def every_weight_used(flags: Sequence[str]) -> Iterator[None]:
    """Let data-parallel training of our policy skip the search for unused parameters, which LeRobot asks for.

    A walk over the graph in every step; ours has none left (``training.py``, and a test per training option).
    """
    stock = utils.DistributedDataParallelKwargs

    def handler(**given: Any) -> Any:
        return stock(**{**given, "find_unused_parameters": False})

    if trains_ours(flags):
        utils.DistributedDataParallelKwargs = handler
    try:
        yield
    finally:
        utils.DistributedDataParallelKwargs = stock


@contextmanager
def process_group_kept() -> Iterator[None]:
    """Let the process group live as long as the process, so that training on several processes can't hang at its end.

    LeRobot's trainer drops the group with its last frame, microseconds after a barrier. Whoever drops it holds Python's
    lock and waits for gloo's thread; that thread may still be letting go of the barrier's tensors, for which it wants
    the lock: a deadlock inside PyTorch (``~Reducer`` → ``~ProcessGroupGloo`` → ``join``), seen once.
    """
    stock = PartialState.destroy_process_group

    def destroy(state: PartialState, group: Any = None) -> None:
        KEPT_GROUPS.append(group or torch.distributed.group.WORLD)
        stock(state, group)

    PartialState.destroy_process_group = destroy
    try:
        yield
    finally:
        PartialState.destroy_process_group = stock


def trains_ours(flags: Sequence[str]) -> bool:
    """Return whether these flags name a pi05_uniforce, by type or by the folder it starts or goes on from."""
    given = dict(flag[2:].split("=", 1) for flag in flags if flag.startswith("--") and "=" in flag)
    started = Path(given.get("policy.path", "")) / "config.json"
    resumed = Path(given.get("config_path", "")).parent / "config.json"
    for key, config in (("policy.path", started), ("config_path", resumed)):
        if key in given and config.is_file():
            return json.loads(config.read_text()).get("type") == OURS
    return given.get("policy.type") == OURS


def main(argv: Sequence[str] | None = None) -> None:
    """Run ``lerobot-train`` on the given arguments (the process's own when None)."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments in (["--help"], ["-h"]):
        print(HELP)
        return
    register_third_party_plugins()
    flags = to_lerobot(arguments)
    before, sys.argv = sys.argv, [sys.argv[0], *flags]  # LeRobot's parser reads sys.argv itself
    try:
        with training_views(), every_weight_used(flags), process_group_kept():
            lerobot_train.main()
    finally:
        sys.argv = before


if __name__ == "__main__":
    main()
