"""An ordinary LeRobot dataset whose state also holds a finger's newtons: for any LeRobot policy.

Marker images are read once, by the finger's force sensor, and left out: a policy such as ACT takes
every image for a scene camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets import LeRobotDataset
from tqdm import tqdm

from uniforce_datasets.features import vector_column, video_column
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.source import Episode, Source, episode_frames, marker_images
from uniforce_datasets.view_build import resize
from uniforce_datasets.view_plan import EpisodeFacts, episode_facts
from uniforce_vtla import keys
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.options import absolute

BATCH = 32  # marker images read at once


def write_force_dataset(
    roots: Sequence[str | Path],
    out: str | Path,
    sensor: ForceSensor,
    image_side: int,
    keep: Callable[[EpisodeFacts], bool],
    verify: str = "quick",
) -> Path:
    """Write the chosen episodes of recorded datasets, with a finger's newtons behind the state.

    Args:
        roots: folders of recorded datasets, joined in order.
        out: folder of the new dataset; it must not exist.
        sensor: of the finger whose newtons are added; not calibrated, as demonstrations are read.
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
    for number, source in enumerate(sources):
        _check_alike(source, sources[0])
        chosen[number] = [episode for episode, facts in episode_facts(source) if keep(facts)]
    if not any(chosen.values()):
        do = "Take episodes with events too, or record more."
        raise DatasetError(expected(", ".join(map(str, roots)), "episodes to take", "none", do))
    dataset = LeRobotDataset.create(
        repo_id=f"local/{out.name}",
        fps=sources[0].fps,
        features=force_features(sources[0].cameras, image_side, sensor),
        root=out,
    )
    try:
        bar = tqdm(total=sum(map(len, chosen.values())), desc="episodes", unit="episode")
        for number, source in enumerate(sources):
            # the whole dataset's, read once
            columns = source.columns((keys.STATE, keys.ACTION))
            columns[keys.TASK] = source.instructions()
            for episode in chosen[number]:
                for row in _rows(source, episode, columns, sensor, image_side):
                    dataset.add_frame(row)
                dataset.save_episode()
                bar.update()
        bar.close()
    finally:
        dataset.finalize()
    return out


def force_features(cameras: Sequence[str], side: int, sensor: ForceSensor) -> dict[str, dict]:
    """Return LeRobot's features: scene cameras, state with newtons, action."""
    features = {keys.camera_key(camera): video_column((side, side, 3)) for camera in cameras}
    features[keys.STATE] = vector_column((*keys.AXES, *keys.force_axes(sensor.finger)))
    features[keys.STATE]["info"] = sensor.facts()
    features[keys.ACTION] = vector_column(keys.AXES)
    return features


def _check_alike(source: Source, first: Source) -> None:
    if source.fps != first.fps or sorted(source.cameras) != sorted(first.cameras):
        wanted = f"{first.fps} Hz and {sorted(first.cameras)}"
        came = f"{source.fps} Hz and {sorted(source.cameras)}"
        raise DatasetError(expected(str(source.root), wanted, came, "Leave it out."))


def _rows(
    source: Source,
    episode: Episode,
    columns: dict[str, np.ndarray],
    sensor: ForceSensor,
    side: int,
) -> Iterator[dict[str, Any]]:
    """Yield an episode's frames as LeRobot records them."""
    state = columns[keys.STATE][episode.rows].astype(np.float32)  # (T, 5)
    action = columns[keys.ACTION][episode.rows].astype(np.float32)
    tasks = columns[keys.TASK][episode.rows]
    force_N = read_episode(source, episode, sensor)  # (T, 3)
    pictures = {}
    for camera in source.cameras:
        key = keys.camera_key(camera)
        pictures[key] = episode_frames(episode.videos[key], episode.length, source.fps)
    for frame in range(episode.length):
        row: dict[str, Any] = {
            keys.STATE: np.concatenate([state[frame], force_N[frame]]),
            keys.ACTION: action[frame],
            keys.TASK: str(tasks[frame]),
        }
        for key, frames in pictures.items():
            row[key] = resize(next(frames), side)
        yield row


def read_episode(source: Source, episode: Episode, sensor: ForceSensor) -> np.ndarray:
    """Return (T, 3) float32 N that a finger felt, in its own frame."""
    sensor.reset()
    reference, current = marker_images(episode, source.fps, sensor.finger)
    forces = [sensor.read_forces(reference, np.stack(images)) for images in batched(current, BATCH)]
    return np.concatenate(forces)
