"""Read a recorded dataset file by file, without LeRobot and the hub: whole or not at all."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from uniforce_datasets.dataset_info import parquet_files, read_info, videos
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import TACTILE_KEYS, camera_key, tactile_key
from uniforce_vtla.options import absolute

# the last: metadata that is no text, no codec
BROKEN_VIDEO = (av.error.FFmpegError, OSError, IndexError, ValueError)
MAX_PIXELS = 4096 * 2304  # of a frame; a damaged header may announce gigabytes
LONGEST_VIDEO_S = 1e6  # eleven days; a start beyond is no number anybody wrote on purpose
SPAN = ("chunk_index", "file_index", "from_timestamp")  # columns of a video of an episode


@dataclass(frozen=True)
class VideoSpan:
    """Where an episode's frames are: a file and the second its first frame has in it."""

    file: Path
    from_s: float


@dataclass(frozen=True, eq=False)
class Episode:
    """One recorded episode."""

    index: int  # its number in the dataset
    start: int  # index of its first frame in the dataset
    length: int  # frames
    task: str  # the instruction in words; one of them where it changes within the episode
    videos: dict[str, VideoSpan]  # span by video key

    @property
    def rows(self) -> slice:
        """Frames of the episode within a column of the dataset."""
        return slice(self.start, self.start + self.length)


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

    @property
    def cameras(self) -> list[str]:
        """Names of the scene cameras."""
        found = []
        for key in videos(self.info):
            if key.startswith(camera_key("")) and key not in TACTILE_KEYS:
                found.append(key.removeprefix(camera_key("")))
        return found

    def instructions(self) -> np.ndarray:
        """Return (N,) the instruction of every frame, in words.

        Raises DatasetError: ``meta/tasks.parquet`` is missing or damaged, or lacks an instruction.
        """
        file = self.root / "meta" / "tasks.parquet"
        numbers = self.columns(("task_index",))["task_index"].ravel()
        try:
            tasks = pd.read_parquet(file)["task_index"]
            words = pd.Series(tasks.index, index=tasks).reindex(numbers).to_numpy(object)
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            raise DatasetError(
                expected(str(file), "instructions by number", error, "Restore it from a copy.")
            ) from error
        if not all(isinstance(word, str) for word in words):
            do = "Restore it from a copy."
            raise DatasetError(expected(str(file), "an instruction for every frame", "none", do))
        return words

    def columns(self, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return (N, D) or (N,) columns of all frames; DatasetError: frames are missing."""
        columns = read_columns(self.root, ("index", *keys))
        order = np.argsort(columns["index"], kind="stable")
        order = order[columns["index"][order] < self.num_frames]
        if not np.array_equal(columns["index"][order], np.arange(self.num_frames)):
            wanted = f"{self.num_frames} frames"
            where = str(self.root / "data")
            raise DatasetError(expected(where, wanted, len(order), "Files are missing."))
        return {key: columns[key][order] for key in keys}


def read_source(root: str | Path, within: Path | None = None) -> Source:
    """Open a dataset; its links may lead into ``within``, by default the dataset itself.

    Raises DatasetError: no dataset there, no episode, broken metadata, or a path or link that leads
    out of it.
    """
    root = absolute(root)
    info = read_info(root, within)
    return Source(root, info, _episodes(root, info))


def _episodes(root: Path, info: dict[str, Any]) -> tuple[Episode, ...]:
    folder = root / "meta" / "episodes"
    keys = videos(info)
    columns = ["episode_index", "dataset_from_index", "length", "tasks"]
    for key in keys:
        columns += [f"videos/{key}/{part}" for part in SPAN]
    rows = []
    for file in parquet_files(folder):
        for row in read_table(file, columns).to_pylist():
            _check_row(str(folder), row, keys)
            rows.append(row)
    rows.sort(key=itemgetter("episode_index"))
    found: list[Episode] = []
    start = 0
    in_order = True
    for number, row in enumerate(rows[: info["total_episodes"]]):
        in_order &= row["episode_index"] == number and row["dataset_from_index"] == start
        found.append(_episode(root, info, row, keys))
        start += row["length"]
    if len(found) != info["total_episodes"] or not in_order or start != info["total_frames"]:
        wanted = (
            f"{info['total_episodes']} episodes of {info['total_frames']} frames, one after another"
        )
        came = f"{len(found)} of {start}"
        raise DatasetError(expected(str(folder), wanted, came, "Files are missing."))
    return tuple(found)


def _check_row(where: str, row: dict[str, Any], keys: list[str]) -> None:
    counts = ["episode_index", "dataset_from_index", "length"]
    task = row["tasks"]
    if isinstance(task, list) and task:
        task = task[0]
    whole = isinstance(task, str)
    for key in keys:
        counts += [f"videos/{key}/chunk_index", f"videos/{key}/file_index"]
        from_s = row[f"videos/{key}/from_timestamp"]
        whole &= type(from_s) is float and 0 <= from_s < LONGEST_VIDEO_S
    for name in counts:
        whole &= type(row[name]) is int and row[name] >= 0
    if not whole or row["length"] == 0:
        came = {name: row[name] for name in (*counts[:3], "tasks")}
        do = "Restore it from a copy."
        raise DatasetError(expected(where, "counts, seconds and a task", repr(came)[:200], do))


def _episode(root: Path, info: dict[str, Any], row: dict[str, Any], keys: list[str]) -> Episode:
    spans = {}
    for key in keys:
        path = info["video_path"].format(
            video_key=key,
            chunk_index=row[f"videos/{key}/chunk_index"],
            file_index=row[f"videos/{key}/file_index"],
        )
        spans[key] = VideoSpan(root / path, row[f"videos/{key}/from_timestamp"])
    task = row["tasks"]
    if not isinstance(task, str):
        task = task[0]
    return Episode(row["episode_index"], row["dataset_from_index"], row["length"], task, spans)


def read_columns(root: Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Read (N, D) or (N,) columns of every data file, in file order.

    Columns are joined as arrays: LeRobot's tools store the same rows as another Arrow type.

    Raises DatasetError: no data file, or one that can't be read.
    """
    files = parquet_files(root / "data")
    if not files:
        raise DatasetError(
            expected(str(root), "data/**/*.parquet", "none", "Record episodes first.")
        )
    parts: dict[str, list[np.ndarray]] = defaultdict(list)
    for file in files:
        table = read_table(file, list(keys))
        for key in keys:
            parts[key].append(_as_array(str(file), key, table[key].combine_chunks()))
    columns = {}
    for key, arrays in parts.items():
        kinds = {f"{array.dtype}{list(array.shape[1:])}" for array in arrays}
        if len(kinds) > 1:
            where = f"{key} in {root / 'data'}"
            do = "Files of different recordings lie together."
            raise DatasetError(expected(where, "one kind of numbers", sorted(kinds), do))
        columns[key] = np.concatenate(arrays)
    return columns


def _as_array(where: str, key: str, column: pa.Array) -> np.ndarray:
    """Return (N, D) or (N,) numbers."""
    nested = hasattr(column, "flatten") and pa.types.is_nested(column.type)
    values = column.flatten() if nested else column
    flat = values.to_numpy(zero_copy_only=False)
    ragged = nested and (len(column) == 0 or len(flat) % len(column))
    if column.null_count or ragged or flat.dtype.kind not in "biuf":
        came = f"{column.type} with {column.null_count} missing"
        raise DatasetError(
            expected(f"{key} in {where}", "rows of numbers", came, "Restore it from a copy.")
        )
    return flat.reshape(len(column), -1) if nested else flat


def read_table(file: Path, keys: list[str]) -> pa.Table:
    """Read columns of a parquet file; DatasetError: it is missing, damaged, or lacks one."""
    try:
        return pq.ParquetFile(file).read(columns=keys).select(keys).replace_schema_metadata(None)
    except KeyError as error:
        raise DatasetError(
            expected(str(file), f"columns {keys}", error, "Record it with this version.")
        ) from error
    except (pa.ArrowException, OSError, ValueError) as error:
        do = "It is truncated: restore it from a copy."
        raise DatasetError(expected(str(file), "a whole parquet file", error, do)) from error


def episode_frames(span: VideoSpan, length: int, fps: int, first: int = 0) -> Iterator[np.ndarray]:
    """Yield (H, W, 3) uint8 RGB frames ``first`` … ``length − 1`` of an episode.

    Raises DatasetError: the video is missing, truncated, or shorter than the episode.
    """
    start_s = span.from_s + (first - 0.5) / fps
    missing = length - first
    with opened_video(span.file) as video:
        stream = video.streams.video[0]
        if stream.codec_context is None:
            raise ValueError("no known codec")
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        video.seek(max(0, int(start_s / float(stream.time_base or 1))), stream=stream)
        for frame in video.decode(stream):
            if missing and frame.time is not None and frame.time >= start_s:
                missing -= 1
                yield frame.to_ndarray(format="rgb24")
            if not missing:
                return
    do = "The video is truncated: restore it."
    raise DatasetError(expected(str(span.file), f"{length} frames", length - missing, do))


def stored_frames(file: Path) -> int:
    """Return the frame count in a video's header; raise DatasetError if it can't be opened."""
    with opened_video(file) as video:
        return video.streams.video[0].frames


@contextmanager
def opened_video(
    file: Path,
    wanted: str = "a whole video",
    do: str = "Restore it from a copy or delete the episode.",
) -> Iterator[av.container.InputContainer]:
    """Open a video; DatasetError, which asks for ``wanted``: it is broken, there or further on."""
    try:
        with av.open(str(file)) as video:
            yield video
    except BROKEN_VIDEO as error:
        raise DatasetError(expected(str(file), wanted, error, do)) from error


def marker_images(
    episode: Episode, fps: int, finger: Finger
) -> tuple[np.ndarray, Iterator[np.ndarray]]:
    """Return an episode's reference (H, W), and its marker images (H, W) one by one.

    Raises DatasetError: (when read) frames that are missing or truncated.
    """
    reference_span = episode.videos[tactile_key(finger, reference=True)]
    reference = next(episode_frames(reference_span, episode.length, fps))
    current = episode_frames(episode.videos[tactile_key(finger)], episode.length, fps)
    return _grey(reference), map(_grey, current)


def _grey(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[..., 0])
