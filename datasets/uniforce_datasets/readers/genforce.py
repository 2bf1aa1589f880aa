"""GenForce-Hetero: ``{img,force,depth}/<sensor>/<indenter>/<trial>/``, marker images and ft.csv.

Images: ``0000.npy`` of packed bits (480·640/8 = 38,400 bytes) or plain (480, 640) arrays, or
``0000.jpg`` (uSkin), white above 50. Forces: first three columns of ft.csv, N; Fz is negative in
compression. Only the format was looked up; none of the authors' code is used.
"""

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from uniforce_datasets.dataset_info import inside
from uniforce_datasets.readers.files import (
    existing_folder,
    numbered_images,
    read_marker_picture,
    read_table,
    subfolders,
)
from uniforce_datasets.readers.recording import LabelledRecording
from uniforce_vtla.array_file import read_array
from uniforce_vtla.contact import UNSEEN
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import ContractError, DatasetError, expected, require_one_of

log = logging.getLogger(__name__)
PACKED_BYTES = MARKER_IMAGE_SHAPE[0] * MARKER_IMAGE_SHAPE[1] // 8
# where img/ and force/ may be
LAYOUTS = (".", "hetero", "training/hetero", "dataset/training/hetero")
SPLITS = ("all", "seen", "unseen")
JPEG_WHITE = 50  # grey level above which a JPEG pixel is white, as the release binarises
CLEAR_PULL_N = 2.0  # a pad can't be pulled; tare drift and gel that sticks stay below this
MISSING_DO = "Give the folder that holds img/ and force/ (dataset/training/hetero in the release)."


@dataclass(frozen=True)
class ForceAxes:
    """Name the recorded axis, with its sign, that is each of ours.

    The default is GenForce's: Fz is negative in compression (its labels are normalised from −20 N
    to 5 N), Fx and Fy are taken as image right and image down. No public set documents how a rig's
    shear axes lie in the image: ``shear_agreement`` (benchmarks) finds out whether the signs are
    right.
    """

    x: str = "+x"  # recorded axis that points to the right in the image, e.g. "+x" or "-y"
    y: str = "+y"  # recorded axis that points down in the image
    z: str = "-z"  # recorded axis that is positive in compression

    def __post_init__(self) -> None:
        """Raise ContractError unless the three are signed and different."""
        names = (self.x, self.y, self.z)
        text = " ".join(names)
        signed = re.fullmatch("[+-][xyz] [+-][xyz] [+-][xyz]", text)
        if not signed or not {*"xyz"} <= {*text}:
            do = 'Give each recorded axis once, with its sign, e.g. ForceAxes("+x", "-y", "-z").'
            raise ContractError(expected("force axes", "±x, ±y, ±z in some order", names, do))

    def to_image(self, recorded_N: np.ndarray) -> np.ndarray:
        """Return (T, 3) float32 forces in our axes from (T, 3 or more) recorded ones.

        Moments are left aside.
        """
        columns = []
        for axis in (self.x, self.y, self.z):
            column = recorded_N[:, "xyz".index(axis[1])]
            columns.append(-column if axis[0] == "-" else column)
        return np.stack(columns, axis=1).astype(np.float32)  # (T, 3)


def check_compression(force_N: np.ndarray, where: str) -> None:
    """Raise DatasetError where the strongest normal force is a pull: z has the wrong sign then."""
    pull_N = -float(force_N[:, 2].min())
    push_N = float(force_N[:, 2].max())
    if pull_N > max(push_N, CLEAR_PULL_N):
        came = f"{pull_N:.1f} N of pull, {max(push_N, 0):.1f} N of compression"
        do = "Turn the sign of z in ForceAxes, or is another axis the normal?"
        raise DatasetError(expected(f"{where}, force", "compression positive in z", came, do))


@dataclass(frozen=True)
class ReadOptions:
    """Limits for trials that aren't as the protocol promises, and for memory."""

    # frame taken as free air; a trial begins before contact
    reference: Literal["first", "quietest"] = "first"
    # |F| in it; drift of a tared cell, less than any labelled press
    max_reference_force_N: float = 0.5
    pressed_reference: Literal["refuse", "skip"] = "refuse"  # a trial that has no such frame
    max_frames: int = 256  # per recording, 79 MB of images; a longer trial comes in parts


@dataclass(frozen=True)
class GenForceConfig:
    """Selection of a GenForce folder."""

    sensors: tuple[str, ...] = ()  # kinds to read; empty for all found
    # unseen: sphere_s, triangle, pacman, cone, wave and torus; seen: every other indenter
    split: Literal["all", "seen", "unseen"] = "all"
    axes: ForceAxes = field(default_factory=ForceAxes)  # from the Nano17's axes to ours
    options: ReadOptions = field(default_factory=ReadOptions)


def genforce_root(folder: str | Path) -> Path | None:
    """Return the folder that holds ``img/`` and ``force/`` in one of the known places, or None."""
    for layout in LAYOUTS:
        place = Path(folder) / layout
        if (place / "img").is_dir() and (place / "force").is_dir():
            return place
    return None


def read_genforce(
    folder: str | Path, config: GenForceConfig | None = None
) -> Iterator[LabelledRecording]:
    """Yield every trial of a GenForce folder, sensor by sensor; about one at a time is in memory.

    Raises DatasetError: another layout, an asked sensor that isn't there, a trial without forces or
    with another number of them, a broken image, NaN, a pressed reference, or a path that leads
    outside.
    """
    config = config or GenForceConfig()
    require_one_of("split", config.split, SPLITS)
    root = genforce_root(existing_folder(folder))
    if root is None:
        wanted = f"img/ and force/ in one of {', '.join(LAYOUTS)}"
        raise DatasetError(expected(str(folder), wanted, "neither", MISSING_DO))
    for sensor in _sensors(root, config):
        for indenter in subfolders(sensor, root):
            if config.split != "all" and (indenter.name in UNSEEN) != (config.split == "unseen"):
                continue
            for trial in subfolders(indenter, root):
                yield from _recordings(root, trial, config)


def _sensors(root: Path, config: GenForceConfig) -> list[Path]:
    found = {path.name: path for path in subfolders(root / "img", root)}
    unknown = [name for name in config.sensors if name not in found]
    if unknown or not found:
        wanted = " | ".join(found) or "at least one"
        raise DatasetError(
            expected(f"sensors in {root / 'img'}", wanted, unknown or "none", MISSING_DO)
        )
    return [found[name] for name in config.sensors or found]


def _recordings(root: Path, folder: Path, config: GenForceConfig) -> Iterator[LabelledRecording]:
    """Yield a trial's recordings, at most ``config.options.max_frames`` frames each."""
    sensor, indenter, name = folder.relative_to(root / "img").parts
    where = f"{sensor}/{indenter}/{name}"
    most = config.options.max_frames
    images = list(numbered_images(folder, root, (".npy", ".jpg", ".jpeg")).values())
    forces = inside(root, root / "force" / sensor / indenter / name / "ft.csv")
    force_N = config.axes.to_image(read_forces(forces))
    if len(force_N) != len(images):
        do = "Which force belongs to which frame can't be known: restore the trial."
        raise DatasetError(
            expected(str(forces), f"{len(images)} rows, one per image", len(force_N), do)
        )
    check_compression(force_N, where)
    free_air = _free_air(force_N, where, config.options)
    if free_air is None:
        return
    reference = _image(images[free_air])
    for first in range(0, len(images), most):
        rows = slice(first, first + most)
        frames = np.stack([_image(path) for path in images[rows]])
        yield LabelledRecording(sensor, indenter, name, reference, frames, force_N[rows], first)


def _free_air(force_N: np.ndarray, where: str, options: ReadOptions) -> int | None:
    """Return the index of a trial's reference; None where the trial is to be left out."""
    strength = np.linalg.norm(force_N, axis=1)  # (T,)
    index = 0
    if options.reference == "quietest":
        index = int(strength.argmin())
    if strength[index] <= options.max_reference_force_N:
        return index
    wanted = f"a free-air frame, |F| ≤ {options.max_reference_force_N:g} N"
    came = f"{strength[index]:.2f} N in the {options.reference} frame"
    if options.pressed_reference == "refuse":
        do = 'Leave it out with ReadOptions(pressed_reference="skip"), '
        do += "or raise max_reference_force_N."
        raise DatasetError(expected(where, wanted, came, do))
    log.warning("%s left out: expected %s, got %s", where, wanted, came)
    return None


def read_forces(path: Path) -> np.ndarray:
    """Return (T, 3) float64 of the first three columns of ft.csv, in the rig's own axes.

    Raises DatasetError: no such file, fewer columns, no rows, or cells that are no finite number.
    """
    table = read_table(path)
    values = table.iloc[:, :3]
    numeric = values.select_dtypes("number").shape == (len(table), 3)
    if not numeric or len(table) == 0 or not np.isfinite(values.to_numpy(np.float64)).all():
        came = f"{len(table)} rows of {list(table.columns)[:6]}, or NaN and text between"
        do = "Leave this trial out, or restore the file."
        raise DatasetError(
            expected(str(path), "three columns of finite forces Fx, Fy, Fz", came, do)
        )
    return values.to_numpy(np.float64)


def _image(path: Path) -> np.ndarray:
    return read_packed(path) if path.suffix == ".npy" else read_marker_picture(path, JPEG_WHITE)


def read_packed(path: Path) -> np.ndarray:
    """Return the (480, 640) uint8 marker image of a .npy file.

    It holds packed bits, or a plain 0/1 or 0/255 array.

    Raises DatasetError: truncated, pickled, or of another size or content.
    """
    array = read_array(path)
    if array.dtype == np.uint8 and array.shape == (PACKED_BYTES,):
        return np.unpackbits(array).reshape(MARKER_IMAGE_SHAPE) * np.uint8(255)
    whole = array.shape == MARKER_IMAGE_SHAPE
    if not whole or not (np.isin(array, (0, 1)).all() or np.isin(array, (0, 255)).all()):
        wanted = f"{PACKED_BYTES} packed bytes, or {MARKER_IMAGE_SHAPE} of 0 and 1 or of 0 and 255"
        raise DatasetError(
            expected(str(path), wanted, f"{array.dtype} {array.shape}", "Another image size?")
        )
    return np.where(array > 0, 255, 0).astype(np.uint8)
