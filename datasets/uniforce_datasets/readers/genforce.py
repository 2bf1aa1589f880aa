"""GenForce-Hetero: ``{img,force,depth}/<sensor>/<indenter>/<trial>/`` with packed marker images and ft.csv.

Images: ``0000.npy`` of packed bits (480·640/8 = 38,400 bytes) or plain (480, 640) arrays, or ``0000.jpg`` (uSkin),
white above 50. Forces: first three columns of ft.csv, N; Fz is negative in compression. Only the format was looked
up; none of the authors' code is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from uniforce_datasets.dataset_paths import inside
from uniforce_datasets.readers.files import (
    existing_folder,
    numbered_images,
    read_marker_picture,
    read_table,
    subfolders,
)
from uniforce_datasets.readers.force_axes import ForceAxes
from uniforce_datasets.readers.recording import LabelledRecording
from uniforce_datasets.readers.trial import ReadOptions, Trial, recordings_of
from uniforce_vtla.array_file import read_array
from uniforce_vtla.contact import UNSEEN
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import ContractError, DatasetError, expected

PACKED_BYTES = MARKER_IMAGE_SHAPE[0] * MARKER_IMAGE_SHAPE[1] // 8
LAYOUTS = (".", "hetero", "training/hetero", "dataset/training/hetero")  # where img/ and force/ may be
SPLITS = ("all", "seen", "unseen")
MISSING_DO = "Give the folder that holds img/ and force/ (dataset/training/hetero in the release)."


@dataclass(frozen=True)
class GenForceConfig:
    """What to read of a GenForce folder.

    Attributes:
        sensors: kinds to read; empty for all found.
        split: "unseen" is sphere_s, triangle, pacman, cone, wave and torus; "seen" every other indenter.
        axes: from the Nano17's axes to ours.
        options: reference and memory.
        jpg_threshold: grey level above which a JPEG pixel is white.
    """

    sensors: tuple[str, ...] = ()
    split: Literal["all", "seen", "unseen"] = "all"
    axes: ForceAxes = field(default_factory=ForceAxes)
    options: ReadOptions = field(default_factory=ReadOptions)
    jpg_threshold: int = 50  # grey levels, as the release binarises


def genforce_root(folder: str | Path) -> Path | None:
    """Return the folder that holds ``img/`` and ``force/`` in one of the known places, or None."""
    places = [Path(folder) / layout for layout in LAYOUTS]
    return next((p for p in places if (p / "img").is_dir() and (p / "force").is_dir()), None)


def read_genforce(folder: str | Path, config: GenForceConfig | None = None) -> Iterator[LabelledRecording]:
    """Yield every trial of a GenForce folder, sensor by sensor; about one trial is in memory at a time.

    Raises:
        DatasetError: another layout, an asked sensor that isn't there, a trial without forces or with another
            number of them, a broken image, NaN, a pressed reference, or a path that leads outside.
    """
    config = config or GenForceConfig()
    if config.split not in SPLITS:
        raise ContractError(expected("split", " | ".join(SPLITS), repr(config.split), "Choose one."))
    root = genforce_root(existing_folder(folder))
    if root is None:
        wanted = f"img/ and force/ in one of {', '.join(LAYOUTS)}"
        raise DatasetError(expected(str(folder), wanted, "neither", MISSING_DO))
    for sensor in _sensors(root, config):
        for indenter in subfolders(sensor, root):
            if config.split != "all" and (indenter.name in UNSEEN) != (config.split == "unseen"):
                continue
            for trial in subfolders(indenter, root):
                yield from recordings_of(_trial(root, trial, config), config.options)


def _sensors(root: Path, config: GenForceConfig) -> list[Path]:
    found = {path.name: path for path in subfolders(root / "img", root)}
    wanted = config.sensors or tuple(found)
    unknown = [name for name in wanted if name not in found]
    if unknown or not found:
        came = unknown or "none"
        raise DatasetError(
            expected(f"sensors in {root / 'img'}", " | ".join(found) or "at least one", came, MISSING_DO)
        )
    return [found[name] for name in wanted]


def _trial(root: Path, folder: Path, config: GenForceConfig) -> Trial:
    sensor, indenter, name = folder.relative_to(root / "img").parts
    images = numbered_images(folder, root, (".npy", ".jpg", ".jpeg"))
    forces = inside(root, root / "force" / sensor / indenter / name / "ft.csv")
    recorded_N = read_forces(forces)
    if len(recorded_N) != len(images):
        do = "Which force belongs to which frame can't be known: restore the trial."
        raise DatasetError(expected(str(forces), f"{len(images)} rows, one per image", len(recorded_N), do))
    signal = partial(_images, images, config.jpg_threshold)
    return Trial(sensor, indenter, name, config.axes.to_image(recorded_N), signal)


def read_forces(path: Path) -> np.ndarray:
    """Return (T, 3) float64 of the first three columns of ft.csv, in the rig's own axes.

    Raises:
        DatasetError: no such file, fewer columns, no rows, or cells that are no finite number.
    """
    table = read_table(path)
    values = table.iloc[:, :3]
    numeric = values.shape[1] == 3 and all(np.issubdtype(kind, np.number) for kind in values.dtypes)
    if not numeric or len(values) == 0 or not np.isfinite(values.to_numpy(np.float64)).all():
        came = f"{len(table)} rows of {list(table.columns)[:6]}, or NaN and text between"
        do = "Leave this trial out, or restore the file."
        raise DatasetError(expected(str(path), "three columns of finite forces Fx, Fy, Fz", came, do))
    return values.to_numpy(np.float64)


def _images(paths: list[Path], threshold: int, first: int) -> Iterator[np.ndarray]:
    for path in paths[first:]:
        is_array = path.suffix == ".npy"
        yield read_packed(path) if is_array else read_marker_picture(path, threshold)


def read_packed(path: Path) -> np.ndarray:
    """Return the (480, 640) uint8 marker image of a .npy file: packed bits, or a plain 0/1 or 0/255 array.

    Raises:
        DatasetError: truncated, pickled, or of another size or content.
    """
    array = read_array(path)
    if array.dtype == np.uint8 and array.shape == (PACKED_BYTES,):
        return np.unpackbits(array).reshape(MARKER_IMAGE_SHAPE) * np.uint8(255)
    values = set(np.unique(array)) if array.shape == MARKER_IMAGE_SHAPE else None
    if values is None or not (values <= {0, 1} or values <= {0, 255}):
        wanted = f"{PACKED_BYTES} packed bytes, or {MARKER_IMAGE_SHAPE} of 0 and 1 or of 0 and 255"
        raise DatasetError(expected(str(path), wanted, f"{array.dtype} {array.shape}", "Another image size?"))
    return np.where(array > 0, 255, 0).astype(np.uint8)
