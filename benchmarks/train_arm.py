"""Train one checkpoint of the wiping benchmark as the plan says, with LeRobot's own trainer; resumable."""

import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from benchmarks.wiping_plan import RECIPES, Recipe
from uniforce_cli import lerobot_training
from uniforce_cli.boundary import command
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.options import Count, CountOrZero, Names, OutFolder, Seed, View

RecipeName = Annotated[str, Names(tuple(RECIPES))]


@dataclass
class TrainArmConfig:
    """Train a checkpoint of the plan from one view of both rigs' demos; run it again to go on after any stop.

    Example: python -m benchmarks.train_arm name=vt view=outputs/view_paper seed=0
    """

    name: RecipeName = "vt"  # v | vt | vtg | vtu, or a control: wrench | descriptor | images
    view: View = "outputs/view_paper"  # training view that holds the demos of both rigs
    demos: CountOrZero = 0  # only the first so many of each rig, for the curve of success over demos; 0 = all
    steps: Count = 6000  # optimiser steps, the same for every arm
    batch_size: Count = 32  # samples per step
    seed: Seed = 0  # of weights and batches; the plan asks for two
    save_every: Count = 1000  # steps between checkpoints a killed run continues from
    out: OutFolder = "outputs/arms"  # the checkpoint lies in OUT/seedS/NAME when done


def arguments(config: TrainArmConfig, recipe: Recipe, run: Path) -> list[str]:
    """Return what ``uniforce train`` is called with.

    Raises:
        DatasetError: no view, or one without demos of a rig the recipe needs.
    """
    slots = ", ".join(f"{slot}: {finger}" for slot, finger in recipe.slots)
    return [
        "policy=pi05_uniforce",
        "policy.size=tiny",
        "policy.device=cpu",
        "policy.recipe=scored",
        f"policy.touch.input={recipe.touch_input}",
        f"policy.touch.slots={{{slots}}}",
        "dataset.repo_id=local/view",
        f"dataset.root={config.view}",
        f"dataset.episodes={_episodes(Path(config.view), recipe, config.demos)}",
        f"steps={config.steps}",
        f"save_freq={config.save_every}",
        f"batch_size={config.batch_size}",
        "num_workers=0",
        "log_freq=100",
        f"seed={config.seed}",
        f"output_dir={run}",
    ]


def _episodes(view: Path, recipe: Recipe, demos: int) -> list[int]:
    """Return the numbers of the view's episodes recorded on the recipe's rigs, ``demos`` of each if not 0."""
    marker = view / VIEW_MARKER
    if not marker.is_file():
        do = "Record both rigs and run uniforce view."
        raise DatasetError(expected(str(view), "a training view", "none", do))
    facts = read_object(marker, DatasetError).get("episodes", [])  # the trainer checks the rest of it
    found = {rig: [i for i, e in enumerate(facts) if e["left_sensor"] == rig] for rig in recipe.rigs}
    missing = [rig for rig, episodes in found.items() if not episodes]
    if missing:
        raise DatasetError(expected(str(view), f"demos of {recipe.rigs}", f"none of {missing}", "Record them."))
    fewest = min(len(episodes) for episodes in found.values())
    if demos > fewest:
        do = f"Record more, or ask for at most {fewest}."
        raise DatasetError(expected(str(view), f"{demos} demos of each rig", fewest, do))
    return sorted(i for episodes in found.values() for i in episodes[: demos or None])


def _label(config: TrainArmConfig) -> str:
    return f"{config.name}_{config.demos}demos" if config.demos else config.name


def train_arm(config: TrainArmConfig) -> Path:
    """Train, or go on training, and return the folder of the finished checkpoint."""
    recipe = choose(RECIPES, config.name)[config.name]
    done = Path(config.out) / f"seed{config.seed}" / _label(config)
    run = Path(config.out) / "runs" / f"{_label(config)}_seed{config.seed}"
    last = run / "checkpoints" / "last" / "pretrained_model"
    if done.exists():
        return done
    if (last / "train_config.json").exists():
        lerobot_training.train(["resume=true", f"config_path={last / 'train_config.json'}"])
    else:
        lerobot_training.train(arguments(config, recipe, run))
    done.parent.mkdir(parents=True, exist_ok=True)
    done.symlink_to(last.resolve(), target_is_directory=True)
    return done


@command(TrainArmConfig)
def main(config: TrainArmConfig) -> None:
    """Entry of ``python -m benchmarks.train_arm``."""
    logging.basicConfig(level=logging.INFO)
    print(f"checkpoint in {train_arm(config)}")


if __name__ == "__main__":
    sys.exit(main())
