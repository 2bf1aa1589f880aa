"""Look at recorded episodes: a page with a slider for any browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from uniforce_cli.boundary import Head, Verify, command, one_thread
from uniforce_vtla.arguments import numbers
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import OUTCOME, OUTCOME_NAMES, SEED, sensor_key
from uniforce_vtla.options import (
    Dataset,
    FolderPath,
    Numbers,
    OutFolder,
    Pattern,
    TokenizerFolder,
    split,
)
from uniforce_vtla.results_file import provenance, write_json

if TYPE_CHECKING:
    from uniforce_datasets.source import Episode, Source
    from uniforce_vtla.evaluation.episode_summary import EpisodeSummary

Episodes = Annotated[str, Pattern("all, or numbers", r"all|\d{1,9}(\s*,\s*\d{1,9})*", "0,3")]


@dataclass
class ShowDatasetConfig:
    """Show what recorded episodes saw and measured.

    Cameras, markers, latents, forces and events on one time line.

    Example: uniforce show root=outputs/demos episode=0,3 out=outputs/show
    """

    root: Dataset = "outputs/demos"  # recorded dataset, from a robot or from the simulator
    episode: Episodes = "0"  # numbers, comma between them; all = every one
    out: OutFolder = "outputs/show"  # gets a page for each episode, which holds its pictures
    # left,right: pull slowly until the object slides; empty = slippage isn't judged
    pad_friction: Numbers = ""
    head: Head = "tactip"  # reads newtons: a sensor kind's shipped head, or a folder
    tokenizer: TokenizerFolder = ""  # of the latents; empty = shipped
    # folder of uniforce calibrate for the left finger's sensor; empty = none
    left_calibration: FolderPath = ""
    # folder of uniforce calibrate for the right finger's sensor; empty = none
    right_calibration: FolderPath = ""
    verify: Verify = "quick"  # how the dataset is checked first


def show_dataset(config: ShowDatasetConfig) -> list[Path]:
    """Write a page for each chosen episode and return their paths.

    Raises ContractError: unknown episode, friction of the wrong form; DatasetError: a dataset that
    can't be read, lacks a finger, or is truncated; CheckpointError: a tokenizer or head that can't
    be loaded.
    """
    from tqdm import tqdm

    from uniforce_cli.dataset_sheet import write_sheet
    from uniforce_cli.episode_films import read_films
    from uniforce_cli.recorded_episode import RecordingForces, finger_sensors, summarise_episode

    friction: tuple[float, float] | None = None
    if config.pad_friction:
        left, right = numbers("pad_friction", config.pad_friction, len(FINGERS)).tolist()
        friction = left, right
    sensors = finger_sensors(
        config.head, config.tokenizer, config.left_calibration, config.right_calibration
    )
    recording = RecordingForces(config.root, sensors, config.verify)
    out = Path(config.out)
    written = []
    for episode in tqdm(_chosen(recording.source, config.episode), desc="episodes", unit="episode"):
        title = f"{Path(config.root).name}, episode {episode.index}"
        stem = f"episode_{episode.index}"
        summary = summarise_episode(recording, episode, friction, title)
        facts = _facts(recording.source, episode, config)
        films = read_films(summary, recording.source, episode)
        written.append(write_sheet(summary, films, facts, out, stem))
        read_by = {finger: sensor.facts() for finger, sensor in sensors.items()}
        content = _numbers(summary, facts) | {"read_by": read_by}
        write_json(out / f"{stem}.json", content | provenance())
    return written


def _chosen(source: Source, text: str) -> list[Episode]:
    if text == "all":
        return list(source.episodes)
    words = split(text)
    known = {str(episode.index): episode for episode in source.episodes}
    if not words or set(words) - set(known):
        wanted = f"all, or numbers from 0 to {len(known) - 1}"
        raise ContractError(expected("episode", wanted, repr(text), "Commas between them."))
    return [known[word] for word in words]


def _facts(source: Source, episode: Episode, config: ShowDatasetConfig) -> dict[str, str]:
    """Return the lines at the top of a page."""
    from uniforce_cli.recorded_episode import worn

    facts = {"task": episode.task, "length": f"{episode.length} frames at {source.fps} Hz"}
    for finger in FINGERS:
        if sensor_key(finger) in source.features:
            facts[f"{finger} sensor"] = worn(source, episode, finger)
    if {OUTCOME, SEED} <= source.features.keys():
        columns = source.columns((OUTCOME, SEED))
        outcome = int(columns[OUTCOME][episode.start])
        name = f"unknown ({outcome})"
        if 0 <= outcome < len(OUTCOME_NAMES):
            name = OUTCOME_NAMES[outcome].replace("_", " ")
        facts["recorded outcome"] = name
        facts["seed"] = str(int(columns[SEED][episode.start]))
    facts["forces read by"] = f"force head {config.head}, from latents"
    return facts


def _numbers(summary: EpisodeSummary, facts: dict[str, str]) -> dict[str, object]:
    """Return what the pictures show, as numbers."""
    content: dict[str, object] = {
        "what": "estimates from marker images and the robot's own height",
        "facts": facts,
        "verdict": summary.verdict,
        "verdict_from_true_forces": summary.true_verdict,
        "moments": {k.name: round(float(summary.time_s[k.frame]), 3) for k in summary.key_frames},
        "strongest_N": dict(zip(FINGERS, abs(summary.force_N).max(axis=0).tolist(), strict=True)),
    }
    if summary.found is not None:
        content["press_max_N"] = float(summary.found.press_N.max())
    if summary.true_force_N is not None:
        error = abs(summary.force_N - summary.true_force_N).mean(axis=0)
        content["force_mae_N"] = dict(zip(FINGERS, error.tolist(), strict=True))
    return content


@command(ShowDatasetConfig)
def main(config: ShowDatasetConfig) -> None:
    one_thread()
    written = show_dataset(config)
    print("\n".join(f"written to {path}" for path in written))
