"""Read a recorded dataset file by file, without LeRobot and without the hub: whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import tactile_key


@dataclass(frozen=True)
class VideoSpan:
    """Where an episode's frames are: a file and the second its first frame has in it."""

    file: Path
    from_s: float


@dataclass(frozen=True, eq=False)
class Episode:
    """One recorded episode.

    Attributes:
        index: its number in the dataset.
        start: index of its first frame in the dataset.
        length: frames.
        task: the instruction in words.
        videos: span by video key.
    """

    index: int
    start: int
    length: int
    task: str
    videos: dict[str, VideoSpan]


@dataclass(frozen=True)
class Source:
    """A recorded dataset: its info.json and its episodes."""

    root: Path
    info: dict[str, Any]
    episodes: tuple[Episode, ...]

    @property
    def fps(self) -> int:
        """Frames per second."""
        return int(self.info["fps"])

    @property
    def features(self) -> dict[str, dict]:
        """LeRobot's features dict."""
        return self.info["features"]

    @property
    def num_frames(self) -> int:
        """Frames of all saved episodes."""
        return int(self.info["total_frames"])

    @property
    def fingers(self) -> tuple[Finger, ...]:
        """Fingers with a marker stream."""
        return tuple(f for f in FINGERS if tactile_key(f) in self.features)

    def columns(self, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return (N, D) or (N,) columns of all frames; raise DatasetError where frames are missing."""
        columns = read_columns(self.root, ("index", *keys))
        order = np.argsort(columns["index"], kind="stable")
        order = order[columns["index"][order] < self.num_frames]
        if not np.array_equal(columns["index"][order], np.arange(self.num_frames)):
            raise DatasetError(
                expected(
                    str(self.root / "data"), f"{self.num_frames} frames", len(order), "Files are missing."
                )
            )
        return {key: columns[key][order] for key in keys}


def read_source(root: str | Path) -> Source:
    """Open the dataset at ``root``.

    Raises:
        DatasetError: no dataset there, no episode, or broken metadata.
    """
    root = Path(root)
    info_file = root / "meta" / "info.json"
    if not info_file.is_file():
        raise DatasetError(
            expected(str(root), "meta/info.json", "none", "Give the folder that uniforce-record wrote.")
        )
    try:
        info = json.loads(info_file.read_text())
    except json.JSONDecodeError as error:
        raise DatasetError(expected(str(info_file), "JSON", error, "It is truncated: restore it.")) from error
    if not info["total_episodes"]:
        raise DatasetError(expected(str(root), "episodes", "none", "Record at least one."))
    return Source(root, info, _episodes(root, info))


def _episodes(root: Path, info: dict[str, Any]) -> tuple[Episode, ...]:
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    spans = [f"videos/{k}/{part}" for k in videos for part in ("chunk_index", "file_index", "from_timestamp")]
    keys = ["episode_index", "dataset_from_index", "length", "tasks", *spans]
    files = sorted((root / "meta" / "episodes").rglob("*.parquet"))
    rows = [row for file in files for row in read_table(file, keys).to_pylist()]
    rows = sorted(rows, key=lambda row: row["episode_index"])[: info["total_episodes"]]
    if [row["episode_index"] for row in rows] != list(range(info["total_episodes"])):
        wanted = f"{info['total_episodes']} episodes"
        raise DatasetError(expected(str(root / "meta" / "episodes"), wanted, len(rows), "Files are missing."))
    return tuple(_episode(root, info, row, videos) for row in rows)


def _episode(root: Path, info: dict[str, Any], row: dict[str, Any], videos: list[str]) -> Episode:
    def span(key: str) -> VideoSpan:
        chunk, file = row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"]
        path = info["video_path"].format(video_key=key, chunk_index=chunk, file_index=file)
        return VideoSpan(root / path, row[f"videos/{key}/from_timestamp"])

    start, length, task = row["dataset_from_index"], row["length"], row["tasks"]
    task = task if isinstance(task, str) else task[0]
    return Episode(row["episode_index"], start, length, task, {key: span(key) for key in videos})


def read_columns(root: Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Read (N, D) or (N,) columns of every data file, in file order.

    Raises:
        DatasetError: no data file, or one that can't be read.
    """
    files = sorted((root / "data").rglob("*.parquet"))
    if not files:
        raise DatasetError(expected(str(root), "data/**/*.parquet", "none", "Record episodes first."))
    table = pa.concat_tables([read_table(file, list(keys)) for file in files])
    return {key: _as_array(table[key].combine_chunks()) for key in keys}


def _as_array(column: pa.Array) -> np.ndarray:
    if not hasattr(column, "flatten") or not pa.types.is_nested(column.type):
        return column.to_numpy(zero_copy_only=False)
    return column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1)


def read_table(file: Path, keys: list[str]) -> pa.Table:
    """Read some columns of a parquet file; raise DatasetError if it is missing, truncated or lacks one."""
    try:
        return pq.ParquetFile(file).read(columns=keys).select(keys).replace_schema_metadata(None)
    except (pa.ArrowInvalid, OSError) as error:
        raise DatasetError(
            expected(str(file), "a whole parquet file", error, "It is truncated: restore it from a copy.")
        ) from error
    except KeyError as error:
        raise DatasetError(
            expected(str(file), f"columns {keys}", error, "Record it with this version.")
        ) from error


def episode_frames(span: VideoSpan, length: int, fps: int, first: int = 0) -> Iterator[np.ndarray]:
    """Yield (H, W, 3) uint8 RGB frames ``first`` … ``length − 1`` of an episode.

    Raises:
        DatasetError: the video is missing, truncated, or shorter than the episode.
    """
    start_s = span.from_s + (first - 0.5) / fps
    missing = length - first
    try:
        with av.open(str(span.file)) as video:
            stream = video.streams.video[0]
            video.seek(max(0, int(start_s / float(stream.time_base or 1))), stream=stream)
            for frame in video.decode(stream):
                if missing and frame.time is not None and frame.time >= start_s:
                    missing -= 1
                    yield frame.to_ndarray(format="rgb24")
                if not missing:
                    return
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise DatasetError(
            expected(str(span.file), "a whole video", error, "Restore it from a copy or delete the episode.")
        ) from error
    raise DatasetError(
        expected(str(span.file), f"{length} frames", length - missing, "The video is truncated: restore it.")
    )


def stored_frames(file: Path) -> int:
    """Return how many frames a video's header announces; raise DatasetError if it can't be opened."""
    frames = 0
    try:
        with av.open(str(file)) as video:
            frames = video.streams.video[0].frames
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise DatasetError(
            expected(str(file), "a whole video", error, "Restore it from a copy or delete the episode.")
        ) from error
    return frames
