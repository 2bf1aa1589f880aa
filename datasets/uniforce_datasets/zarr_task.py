"""An Open-X-Tactile task on disk: a zarr v2 group ``data/*`` of time-major arrays and ``meta/episode_ends``.

The keys are those of FTP-1's data processing guide (github.com/michaelyuancb/ftp1-policy, data_processing/README.md,
as of 2026-07-10, read in a public fork on 2026-11-26; paper: arXiv 2606.13102). Keys beyond them are kept too.
"""

import importlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from uniforce_datasets.dataset_info import check_links
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object

TIMESTAMPS, INSTRUCTION = "timestamps", "sub_task_instruction"
CAMERAS = ("camera_main_rgb", "camera_ego_rgb", "right_wrist_camera_rgb", "left_wrist_camera_rgb")
STATES = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("wrist_pose", "arm_joints", "hand_joints"))
GROUP = re.compile(r"(left|right)_tactile_data_(\w+)")
PARTS = ("area", "sensor", "type")  # beside the data of each tactile group
CODECS = {"blosc", "zstd", "zlib", "gzip", "lz4", "bz2", "lzma", "vlen-utf8"}  # zarr knows one that unpickles, too
CHUNK_bytes = 2 << 20
RESTORE = "Restore the task from a copy."


@dataclass(frozen=True, eq=False)
class Task:
    """A checked task: its arrays by key, opened but not read, and where its episodes end."""

    folder: Path
    arrays: dict[str, Any]
    ends: list[int]

    def read(self, key: str, first: int, end: int) -> np.ndarray:
        """Return some frames of an array; raise DatasetError where they are damaged."""
        with _named(f"{self.folder}/data/{key}, frames {first} … {end}"):
            return np.asarray(self.arrays[key][first:end])


def open_task(folder: str | Path) -> Task:
    """Open a task and check all but its values.

    Raises DatasetError: zarr isn't installed, no zarr v2 group, a link that leads out, a documented key that is missing
        or has another shape, a codec that isn't known, ends that are no ends of episodes.
    """
    folder = Path(folder)
    if not (folder / ".zgroup").is_file():
        do = "Give an unzipped task, a folder that ends in .zarr."
        raise DatasetError(expected(str(folder), "a zarr v2 group (.zgroup)", "none", do))
    check_links(folder, folder)
    arrays = {path.parent.name: _open(path.parent) for path in sorted(folder.glob("data/*/.zarray"))}
    task = Task(folder, arrays, _ends(folder / "meta" / "episode_ends"))
    _check_keys(task)
    for key, array in arrays.items():
        _check_array(task, key, array)
    return task


def _open(folder: Path) -> Any:
    zarr, settings = _zarr(), read_object(folder / ".zarray", DatasetError)
    with _named(str(folder)):
        codecs = [codec["id"] for codec in (settings.get("compressor"), *(settings.get("filters") or [])) if codec]
        if not CODECS.issuperset(codecs):
            raise ValueError(f"codecs {codecs}, none but {sorted(CODECS)} are read")
        return zarr.open_array(folder, mode="r", zarr_format=2)


def _zarr() -> ModuleType:
    try:
        return importlib.import_module("zarr")
    except ImportError as error:
        do = "Run `pip install '.[oxt]'`."
        raise DatasetError(expected("Open-X-Tactile", "the package zarr", "none", do)) from error


@contextmanager
def _named(where: str) -> Iterator[None]:
    """Turn what zarr and its codecs raise into an error that names the array."""
    try:
        yield
    except (RuntimeError, ValueError, TypeError, KeyError, IndexError, OSError) as error:
        raise DatasetError(expected(where, "a whole zarr v2 array", repr(error), RESTORE)) from error


def _ends(folder: Path) -> list[int]:
    array = _open(folder)
    with _named(str(folder)):
        ends = np.asarray(array[:])
    if ends.ndim != 1 or ends.dtype.kind not in "iu" or not len(ends) or (np.diff(ends, prepend=0) < 2).any():
        wanted = "growing frame numbers, two frames apart or more"
        raise DatasetError(expected(str(folder), wanted, ends.ravel()[:9].tolist(), RESTORE))
    return ends.tolist()


def _check_keys(task: Task) -> None:
    """Refuse a task without a documented key that a learner needs."""
    groups = [match.groups() for match in map(GROUP.fullmatch, task.arrays) if match]
    needed = [(TIMESTAMPS,), (INSTRUCTION,), CAMERAS, STATES]
    needed += [(f"{side}_tactile_{part}_{group}",) for side, group in groups for part in PARTS]
    needed += [(f"{key}_idx",) for key in STATES if key.endswith("hand_joints") and key in task.arrays]
    missing = [keys for keys in needed if not task.arrays.keys() & set(keys)]
    if missing:
        do = "docs/own_data.md lists the keys: write it."
        raise DatasetError(expected(f"{task.folder}/data", " or ".join(missing[0]), sorted(task.arrays), do))


def _check_array(task: Task, key: str, array: Any) -> None:
    wanted, right = f"{task.ends[-1]} frames, as meta/episode_ends says", array.shape[:1] == (task.ends[-1],)
    if right and key in CAMERAS:
        wanted = "(T, H, W, 3) uint8, even sides, every chunk there"  # zarr would show a missing chunk black
        right = array.ndim == 4 and array.shape[3] == 3 and array.dtype == np.uint8
        right = right and not any(n % 2 for n in array.shape[1:3]) and array.nchunks_initialized == array.nchunks
    elif right and key in STATES:
        wanted, right = "(T, numbers)", array.ndim == 2 and array.dtype.kind in "fiu"
    if not right:
        came = f"{array.shape} {array.dtype}, {array.nchunks_initialized} of {array.nchunks} chunks"
        raise DatasetError(expected(f"{task.folder}/data/{key}", wanted, came, RESTORE))


class TaskWriter:
    """A new task, its arrays compressed as FTP-1 compresses what stays on disk; raises DatasetError without zarr."""

    def __init__(self, folder: Path, ends: list[int]) -> None:
        root = _zarr().open_group(folder, mode="w", zarr_format=2)
        self._frames, self._data = ends[-1], root.create_group("data")
        root.create_group("meta").create_array("episode_ends", data=np.array(ends, np.int64))

    def array(self, key: str, shape: tuple[int, ...], dtype: Any) -> Any:
        """Return a new array of all frames, each of this shape; it is written by slices."""
        blosc = importlib.import_module("numcodecs").Blosc("zstd", clevel=5, shuffle=2)  # 2: bitwise
        frame_bytes = max(1, int(np.prod(shape)) * np.dtype(dtype).itemsize)
        chunks = (min(self._frames, max(1, CHUNK_bytes // frame_bytes)), *shape)
        made = {"shape": (self._frames, *shape), "dtype": dtype, "chunks": chunks, "compressors": blosc}
        return self._data.create_array(key, **made)

    def whole(self, key: str, values: np.ndarray) -> None:
        """Write an array at once."""
        self.array(key, values.shape[1:], values.dtype)[:] = values
