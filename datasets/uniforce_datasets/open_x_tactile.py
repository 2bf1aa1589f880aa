"""Open-X-Tactile tasks to LeRobot v3 datasets and back; recordings of this project to such tasks. See docs/own_data.md.

In LeRobot cameras are videos. Tactile pictures are PNGs, since a lossy codec's changes would look like force. Every
other array is a column ``oxt.KEY`` of exactly its values, which no policy reads. State is wrist pose, arm and hand
joints side by side; the format has no actions, so that an action is the next frame's state, as FTP-1 trains.

Of a recording the format has no key for actions, free-air references, truth and provenance: they stay behind.
"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from uniforce_datasets.features import flat_column, vector_column
from uniforce_datasets.lossless import open_dataset, rehash
from uniforce_datasets.source import Source, episode_frames, read_source
from uniforce_datasets.video_encoder import camera_codec
from uniforce_datasets.zarr_task import CAMERAS, GROUP, INSTRUCTION, STATES, TIMESTAMPS, Task, TaskWriter, open_task
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import ACTION, AXES, STATE, TASK, camera_key, sensor_key, tactile_key
from uniforce_vtla.sensors import list_sensors

CAMERA_KEYS = dict(zip(CAMERAS, map(camera_key, ("front", "ego", "wrist", "wrist_left")), strict=True))
COLUMN = "oxt."
SHAPE = "oxt_shape"  # of a frame in the zarr array, beside a column's feature: LeRobot's columns are flat
NUMBERS = "fiub"  # kinds of numpy's types
GRIPPER_SLOT = 28  # of a one-number gripper among the format's hand joints
BLOCK = 64  # rows whose pictures are decoded at once


def to_lerobot(folder: str | Path, root: str | Path, fps: int) -> Path:
    """Write a task, a folder that ends in .zarr, into ``root`` and return it; its timestamps don't tell the fps.

    Raises DatasetError: a task that isn't whole (see ``open_task``), or ``root`` exists.
    """
    task, codec = open_task(folder), camera_codec()
    with _whole_folder(root) as partial:
        dataset = LeRobotDataset.create("local/oxt", fps, _features(task), root=partial, rgb_encoder=codec)
        for first, end in zip([0, *task.ends], task.ends, strict=False):
            for row in _rows(task, first, end):
                dataset.add_frame(row)
            dataset.save_episode()
        dataset.finalize()
        rehash(partial)
    return Path(root)


def from_lerobot(root: str | Path, folder: str | Path) -> Path:
    """Write a converted task or a recording of this project as a task into ``folder`` and return it.

    Raises DatasetError: a damaged dataset, one of neither kind, or ``folder`` exists.
    """
    dataset, source = open_dataset(root), read_source(root)
    converted = f"{COLUMN}{TIMESTAMPS}" in source.features
    if not converted and source.features.get(STATE, {}).get("names") != list(AXES):
        do = "Give a converted task or a recording of uniforce record."
        raise DatasetError(expected(str(root), f"columns {COLUMN}* or the state {AXES}", "neither", do))
    with _whole_folder(folder) as partial:
        task = TaskWriter(partial, [episode.start + episode.length for episode in source.episodes])
        for key, feature in CAMERA_KEYS.items():
            if feature in source.features:
                _video(source, feature, task.array(key, tuple(source.features[feature]["shape"]), "uint8"))
        if converted:
            _columns(source, dataset.hf_dataset.with_format(None), task)
        else:
            _recording(source, task)
    return Path(folder)


@contextmanager
def _whole_folder(folder: str | Path) -> Iterator[Path]:
    """Give a folder to write into that gets its name when all is written: zarr reads what is missing as zeros."""
    folder = Path(folder)
    partial = folder.with_name(f".{folder.name}.part")
    if folder.exists():
        raise DatasetError(expected(str(folder), "a new folder", "one that exists", "Name another."))
    shutil.rmtree(partial, ignore_errors=True)
    try:
        yield partial
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _pad_key(group: str, pad: int) -> str:
    return camera_key(f"{group}.{pad}")


def _is_pictures(key: str, array: Any) -> bool:
    return GROUP.fullmatch(key) is not None and array.ndim == 5 and array.shape[-1] == 3 and array.dtype == np.uint8


def _features(task: Task) -> dict[str, dict]:
    names = [f"{key}.{i}" for key in STATES if key in task.arrays for i in range(task.arrays[key].shape[1])]
    features = {STATE: vector_column(names), ACTION: vector_column(names)}
    for key, array in task.arrays.items():
        picture = {"names": ["height", "width", "channels"], "shape": array.shape[-3:]}
        if key in CAMERAS:
            features[CAMERA_KEYS[key]] = {"dtype": "video", **picture}
        elif _is_pictures(key, array):
            features |= {_pad_key(key, pad): {"dtype": "image", **picture} for pad in range(array.shape[1])}
        elif array.dtype.kind in NUMBERS:
            column = flat_column(int(np.prod(array.shape[1:])), str(array.dtype))
            features[f"{COLUMN}{key}"] = column | {SHAPE: list(array.shape[1:])}
        else:
            features[f"{COLUMN}{key}"] = flat_column(1, "string")
    return features


def _rows(task: Task, first: int, end: int) -> Iterator[dict[str, Any]]:
    """Yield an episode's frames."""
    values = {key: task.read(key, first, end) for key in task.arrays}
    state = np.concatenate([values[key] for key in STATES if key in values], axis=1).astype(np.float32)
    action = np.concatenate([state[1:], state[-1:]])
    for t in range(end - first):
        row: dict[str, Any] = {STATE: state[t], ACTION: action[t], TASK: str(values[INSTRUCTION][t]).strip()}
        for key, value in values.items():
            if key in CAMERAS:
                row[CAMERA_KEYS[key]] = value[t]
            elif _is_pictures(key, value):
                row |= {_pad_key(key, pad): value[t, pad] for pad in range(value.shape[1])}
            else:
                row[f"{COLUMN}{key}"] = value[t].reshape(-1) if value.dtype.kind in NUMBERS else str(value[t])
        yield row


def _video(source: Source, feature: str, array: Any) -> None:
    """Copy a video; ``array`` is (T, …, H, W, 3)."""
    for episode in source.episodes:
        frames = np.stack(list(episode_frames(episode.videos[feature], episode.length, source.fps)))
        array[episode.start : episode.start + episode.length] = frames.reshape(-1, *array.shape[1:])


def _columns(source: Source, rows: Any, task: TaskWriter) -> None:
    """Copy numbers and words, and tactile pictures, which are PNGs in the tables."""
    for key, feature in source.features.items():
        if SHAPE in feature:
            values = source.columns((key,))[key].reshape(-1, *feature[SHAPE])
            task.whole(key.removeprefix(COLUMN), values.astype(feature["dtype"]))
        elif key.startswith(COLUMN):
            task.whole(key.removeprefix(COLUMN), np.array(rows[key][:]))
    names = [key.removeprefix(camera_key("")) for key, f in source.features.items() if f["dtype"] == "image"]
    for group in {name.rpartition(".")[0]: None for name in names}:
        pads = [_pad_key(group, pad) for pad in range(sum(name.startswith(f"{group}.") for name in names))]
        array = task.array(group, (len(pads), *source.features[pads[0]]["shape"]), "uint8")
        for first in range(0, source.num_frames, BLOCK):
            block = rows.select_columns(pads)[first : first + BLOCK]
            array[first : first + BLOCK] = np.stack([np.stack([*map(np.asarray, block[pad])]) for pad in pads], axis=1)


def _recording(source: Source, task: TaskWriter) -> None:
    """Write what a recording of this project has; its hand is the format's right one."""
    columns = source.columns((STATE, *map(sensor_key, FINGERS)))
    state, frames = columns[STATE], source.num_frames
    task.whole("right_wrist_pose", wrist_pose(state).astype(np.float32))
    task.whole("right_hand_joints", state[:, 4:].astype(np.float32))
    task.whole("right_hand_joints_idx", np.full((frames, 1), GRIPPER_SLOT, np.int32))
    task.whole(TIMESTAMPS, np.concatenate([np.arange(episode.length) / source.fps for episode in source.episodes]))
    task.whole(INSTRUCTION, np.array([episode.task for episode in source.episodes for _ in range(episode.length)]))
    for area, finger in enumerate(FINGERS):  # 0 is the format's thumb, 1 its index finger
        group, key = f"gripper_{finger}", tactile_key(finger)
        worn = [f"{list_sensors()[int(index)]}_markers" for index in columns[sensor_key(finger)].reshape(-1)]
        _video(source, key, task.array(f"right_tactile_data_{group}", (1, *source.features[key]["shape"]), "uint8"))
        task.whole(f"right_tactile_area_{group}", np.full((frames, 1), area, np.int64))
        task.whole(f"right_tactile_sensor_{group}", np.array(worn))
        task.whole(f"right_tactile_type_{group}", np.array(["image"] * frames))


def wrist_pose(state: np.ndarray) -> np.ndarray:
    """Return (T, 6) positions and rotation vectors of a hand that points down, of states (T, 5).

    The format's hand has z where it points and y towards the thumb, here the left finger. Ours turned like that is half
    a turn about an axis that lies level, half a yaw on.
    """
    angle = (state[:, 3] - np.pi / 2) / 2
    turn = np.pi * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return np.concatenate([state[:, :3], turn], axis=1)
