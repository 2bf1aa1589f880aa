"""An ordinary LeRobot dataset of recorded demonstrations, with touch as numbers in its columns.

Marker images are read once, by the finger's force sensor, and left out. Newtons behind the state
are for any LeRobot policy: one such as ACT takes every image for a scene camera. Latents in columns
of their own are for ``pi05_uniforce``, which need not encode a demonstration again at each step.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import batched
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from lerobot.datasets import LeRobotDataset
from tqdm import tqdm

from uniforce_datasets.features import flat_column, vector_column, video_column
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.pooled_quantiles import write_pooled_stats
from uniforce_datasets.source import Episode, Source, episode_frames, marker_images
from uniforce_datasets.view_build import PooledTokenizer, episode_latents, resize
from uniforce_datasets.view_plan import EpisodeFacts, episode_facts, mounted_sensors
from uniforce_vtla import keys
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.options import absolute
from uniforce_vtla.results_file import only_writer

BATCH = 32  # marker images read at once


class Touch(Protocol):
    """How touch stands in the columns of a dataset."""

    def features(self, episodes: Sequence[EpisodeFacts]) -> dict[str, dict]:
        """Return LeRobot's features of the state and of touch."""

    def columns(self, source: Source, episode: Episode, state: np.ndarray) -> dict[str, np.ndarray]:
        """Return an episode's rows of these features, for its (T, 5) state."""


@dataclass(frozen=True)
class NewtonsInState:
    """A finger's newtons behind the state, for any LeRobot policy."""

    sensor: ForceSensor  # not calibrated, as demonstrations are read

    def features(self, episodes: Sequence[EpisodeFacts]) -> dict[str, dict]:
        """Return the feature of the state, with the hashes of what decides the newtons."""
        state = vector_column((*keys.AXES, *keys.force_axes(self.sensor.finger)))
        return {keys.STATE: state | {"info": self.sensor.facts()}}

    def columns(self, source: Source, episode: Episode, state: np.ndarray) -> dict[str, np.ndarray]:
        """Return the (T, 8) state."""
        self.sensor.reset()
        reference, current = marker_images(episode, source.fps, self.sensor.finger)
        forces = []
        for images in batched(current, BATCH):
            forces.append(self.sensor.read_forces(reference, np.stack(images)))
        return {keys.STATE: np.concatenate([state, np.concatenate(forces)], axis=1)}


@dataclass(frozen=True)
class LatentColumns:
    """Each slot's pooled latents in a column, for ``pi05_uniforce``."""

    encoder: PooledTokenizer
    slots: Mapping[str, Finger]  # which finger's latents

    def features(self, episodes: Sequence[EpisodeFacts]) -> dict[str, dict]:
        """Return the features of state and latents, with what the policy compares."""
        kinds = mounted_sensors([vars(facts) for facts in episodes])
        features = {keys.STATE: vector_column(keys.AXES)}
        for slot, finger in self.slots.items():
            column = flat_column(self.encoder.size, "float32")
            column["info"] = {
                "tokenizer": self.encoder.hash,
                "finger": finger,
                "sensors": "+".join(kinds[finger]),
            }
            features[keys.latent_key(slot)] = column
        return features

    def columns(self, source: Source, episode: Episode, state: np.ndarray) -> dict[str, np.ndarray]:
        """Return the (T, 5) state and each slot's (T, K · L) latents."""
        columns = {keys.STATE: state}
        for slot, finger in self.slots.items():
            latents = episode_latents(episode, source.fps, self.encoder, finger)
            columns[keys.latent_key(slot)] = latents
        return columns


def write_felt_dataset(
    roots: Sequence[str | Path],
    out: str | Path,
    touch: Touch,
    image_side: int,
    keep: Callable[[EpisodeFacts], bool],
    verify: str = "quick",
) -> Path:
    """Write the chosen episodes of recorded datasets, with touch as numbers.

    Args:
        roots: folders of recorded datasets, joined in order.
        out: folder of the new dataset; it must not exist.
        touch: how touch stands in its columns.
        image_side: pixels per side of the scene cameras' pictures.
        keep: chooses episodes.
        verify: how the datasets are checked first, see ``check_dataset``.

    Raises DatasetError: a dataset that can't be trusted, no episode is left, datasets of different
    rates or cameras, or ``out`` exists; ContractError: a reference without markers.
    """
    out = absolute(out)
    if out.exists():
        raise DatasetError(expected(str(out), "no folder", "one", "Choose another out."))
    sources = [check_dataset(root, verify) for root in roots]
    chosen: dict[int, list[Episode]] = {}
    taken: list[EpisodeFacts] = []
    for number, source in enumerate(sources):
        _check_alike(source, sources[0])
        kept = [(episode, facts) for episode, facts in episode_facts(source) if keep(facts)]
        chosen[number] = [episode for episode, _ in kept]
        taken += [facts for _, facts in kept]
    if not taken:
        do = "Take episodes with events too, or record more."
        raise DatasetError(expected(", ".join(map(str, roots)), "episodes to take", "none", do))
    cameras = {}
    for camera in sources[0].cameras:
        cameras[keys.camera_key(camera)] = video_column((image_side, image_side, 3))
    # a half-written dataset would look whole
    building = out.with_name(out.name + ".building")
    with only_writer(building):
        shutil.rmtree(building, ignore_errors=True)
        dataset = LeRobotDataset.create(
            repo_id=f"local/{out.name}",
            fps=sources[0].fps,
            features=cameras | touch.features(taken) | {keys.ACTION: vector_column(keys.AXES)},
            root=building,
        )
        try:
            _write_episodes(dataset, sources, chosen, touch, image_side)
        finally:
            dataset.finalize()
        write_pooled_stats(building)
        building.rename(out)
    return out


def _write_episodes(
    dataset: LeRobotDataset,
    sources: Sequence[Source],
    chosen: Mapping[int, Sequence[Episode]],
    touch: Touch,
    image_side: int,
) -> None:
    total = sum(len(episodes) for episodes in chosen.values())
    with tqdm(total=total, desc="episodes", unit="episode") as bar:
        for number, source in enumerate(sources):
            # the whole dataset's, read once
            columns = source.columns((keys.STATE, keys.ACTION))
            columns[keys.TASK] = source.instructions()
            for episode in chosen[number]:
                for row in _rows(source, episode, columns, touch, image_side):
                    dataset.add_frame(row)
                dataset.save_episode()
                bar.update()


def _check_alike(source: Source, first: Source) -> None:
    if source.fps != first.fps or sorted(source.cameras) != sorted(first.cameras):
        wanted = f"{first.fps} Hz and {sorted(first.cameras)}"
        came = f"{source.fps} Hz and {sorted(source.cameras)}"
        raise DatasetError(expected(str(source.root), wanted, came, "Leave it out."))


def _rows(
    source: Source,
    episode: Episode,
    columns: dict[str, np.ndarray],
    touch: Touch,
    side: int,
) -> Iterator[dict[str, Any]]:
    """Yield an episode's frames as LeRobot records them."""
    state = columns[keys.STATE][episode.rows].astype(np.float32)  # (T, 5)
    action = columns[keys.ACTION][episode.rows].astype(np.float32)
    tasks = columns[keys.TASK][episode.rows]
    felt = touch.columns(source, episode, state)  # key → (T, n)
    pictures = {}
    for camera in source.cameras:
        key = keys.camera_key(camera)
        pictures[key] = episode_frames(episode.videos[key], episode.length, source.fps)
    for frame in range(episode.length):
        row: dict[str, Any] = {key: values[frame] for key, values in felt.items()}
        row |= {keys.ACTION: action[frame], keys.TASK: str(tasks[frame])}
        for key, frames in pictures.items():
            row[key] = resize(next(frames), side)
        yield row
