"""Build the training view of recorded demos."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from uniforce_cli.boundary import Verify, by_name, command, one_thread, refuse_unused
from uniforce_vtla.contracts import check_finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import (
    Datasets,
    OutFolder,
    Pattern,
    Pixels,
    Range,
    Slots,
    TokenizerFolder,
    Workers,
    split,
)

if TYPE_CHECKING:
    from uniforce_datasets.view_plan import EpisodeFacts

LatentGrid = Annotated[int, Range(1, 8)]
CameraNames = Annotated[
    str,
    Pattern("camera:recorded name pairs", r"\w+:[^,:]+(,\s*\w+:[^,:]+)*", "front:cam_high"),
]


@dataclass
class ViewConfig:
    """Decode demos once: small camera images and pooled latents that feed the trainer fast.

    Example: uniforce view roots=outputs/demos_gelsight,outputs/demos_uskin out=outputs/view
    """

    roots: Datasets = "outputs/demos"  # dataset folders, joined in order; comma between them
    out: OutFolder = "outputs/view"  # the view's folder: give it to uniforce train as dataset.root
    image_side: Pixels = 56  # pixels per side of the stored camera images; 56 for a tiny policy
    # latents per side after pooling; the policy's latent_grid must be the same
    latent_grid: LatentGrid = 4
    # which finger fills which touch slot by default; both fingers are stored
    slots: Slots = "touch0:right,touch1:left"
    # cameras that were recorded under other names than front and wrist, e.g.
    # front:cam_high,wrist:cam_arm
    cameras: CameraNames = ""
    tokenizer: TokenizerFolder = ""  # folder of a tokenizer; "" = the shipped one
    # also take demos that wiped the board, but with an event or outside the band of force
    keep_events: bool = True
    keep_failures: bool = False  # also take failed demos
    # write an ordinary LeRobot dataset, the right finger's newtons behind its state and no marker
    # images: any LeRobot policy trains on it with lerobot-train
    touch_in_state: bool = False
    # arrays = what uniforce train reads fastest | dataset = an ordinary LeRobot dataset with each
    # slot's latents in a column, which lerobot-train reads
    form: Literal["arrays", "dataset"] = "arrays"
    workers: Workers = 2  # processes; each needs about 1 GB
    # check of the datasets before: full = every byte and frame | quick = sizes, small files, some
    # frames of every episode | off = none
    verify: Verify = "quick"


def make_view(config: ViewConfig) -> Path:
    """Build the view, or go on with an interrupted build; return its folder."""
    from uniforce_datasets.training_view import build_view

    return build_view(
        split(config.roots),
        config.out,
        config.image_side,
        config.latent_grid,
        by_name(config.slots),
        config.tokenizer or None,
        keep=lambda facts: chosen(facts, config),
        workers=config.workers,
        verify=config.verify,
        cameras=by_name(config.cameras),
    )


def chosen(facts: EpisodeFacts, config: ViewConfig) -> bool:
    """Return whether an episode is taken: clean successes always."""
    wiped = facts.outcome == "success"
    return facts.success or config.keep_failures or (config.keep_events and wiped)


def make_dataset(config: ViewConfig) -> Path:
    """Write the demos as an ordinary LeRobot dataset with touch as numbers; return its folder."""
    from uniforce_datasets.felt_dataset import (
        LatentColumns,
        NewtonsInState,
        Touch,
        write_felt_dataset,
    )
    from uniforce_datasets.view_build import PooledTokenizer
    from uniforce_vtla.force_sensor import ForceSensor

    if config.cameras:
        do = "Leave it out: the cameras keep their names."
        wanted = "none with touch_in_state or form=dataset"
        raise ContractError(expected("cameras", wanted, config.cameras, do))
    refuse_unused(config, "an ordinary dataset", ("workers",))
    tokenizer = config.tokenizer or None
    touch: Touch
    if config.touch_in_state:
        refuse_unused(config, "touch_in_state=true", ("latent_grid", "slots"))
        touch = NewtonsInState(ForceSensor("", "right", tokenizer=tokenizer))
    else:
        slots = {slot: check_finger(finger) for slot, finger in by_name(config.slots).items()}
        touch = LatentColumns(PooledTokenizer(tokenizer, config.latent_grid), slots)
    return write_felt_dataset(
        split(config.roots),
        config.out,
        touch,
        config.image_side,
        keep=lambda facts: chosen(facts, config),
        verify=config.verify,
    )


@command(ViewConfig)
def main(config: ViewConfig) -> None:
    one_thread()
    if config.touch_in_state or config.form == "dataset":
        out = make_dataset(config)
        data = f"--dataset.repo_id=local/{out.name} --dataset.root={out} --policy.push_to_hub=false"
        if config.touch_in_state:
            print(f"dataset in {out}, state with the right finger's newtons")
            print(f"next: lerobot-train --policy.type=act {data}")
            print("roll out: lerobot-eval --env.type=uniforce_wiping --env.touch_in_state=true …")
        else:
            print(f"dataset in {out}, latents in columns")
            print(f"next: lerobot-train --policy.type=pi05_uniforce {data}")
        return
    out = make_view(config)
    facts = json.loads((out / "uniforce_view.json").read_text())
    print(f"view in {out}: {len(facts['episodes'])} episodes, {facts['num_frames']} frames")
    tiny = "policy.size=tiny policy.device=cpu steps=6000 batch_size=32"
    data = f"dataset.repo_id=local/view dataset.root={out}"
    train = out.parent / "train"
    print(f"next: uniforce train policy=pi05_uniforce {tiny} {data} output_dir={train}")
