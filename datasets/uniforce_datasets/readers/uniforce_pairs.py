"""UniForce-style pairs: ``<pattern>/<date>/<left>_<right>/marker/<sensor>/<indenter>/000000.jpg``.

640×480 JPEGs of quality 100 with a black border of 4 px; the same index on both sides is a pair. A
folder counts by its ``collection_log.txt``. The layout names no free-air reference. This project's
is ``reference.jpg`` beside the frames, or one for the whole sensor a level higher; where there is
none, the caller names the frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np

from uniforce_datasets.dataset_info import inside
from uniforce_datasets.readers.files import (
    existing_folder,
    find,
    numbered_images,
    read_marker_picture,
    subfolders,
)
from uniforce_datasets.readers.recording import PairRecording
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import ContractError, DatasetError, expected

LOG_FILE = "collection_log.txt"
REFERENCE_FILE = "reference.jpg"
ENDINGS = (".jpg", ".jpeg", ".png")
BORDER_PX = 4  # black on all sides, as the format has it
HALF_WAY = 127  # grey level: a quality-100 JPEG of a binary image stays far on its side


@dataclass(frozen=True)
class PairConfig:
    """Selection of a folder of pairs."""

    # frame of free air where there is no reference.jpg; None refuses such a set
    reference_index: int | None = None
    indenters: tuple[str, ...] = ()  # names to read; empty for all
    max_frames: int = 256  # pairs per recording: two stacks of 79 MB; more come in parts


def read_uniforce_pairs(
    folder: str | Path, config: PairConfig | None = None
) -> Iterator[PairRecording]:
    """Yield the pairs of every indenter, at most ``config.max_frames`` at a time.

    Raises DatasetError: no collection_log.txt, folders that don't name two sensors, indices on one
    side only, no reference, a broken image, or a path that leads outside.
    """
    config = config or PairConfig()
    root = existing_folder(folder)
    logs = find(root, LOG_FILE)
    if not logs:
        wanted = f"<pattern>/<date>/<left>_<right>/{LOG_FILE}"
        raise DatasetError(expected(str(root), wanted, "none", "Is this a folder of pairs?"))
    for log in logs:
        pairs = log.parent
        sensors = _sensors(pairs, root)
        for indenter in _indenters(pairs, sensors, root, config):
            yield from _recordings(root, pairs, sensors, indenter, config)


def _sensors(folder: Path, root: Path) -> tuple[str, str]:
    """Return (left, right) of a ``<left>_<right>`` folder.

    Names may hold "_", so the folders in marker/ decide.

    Raises DatasetError: its name isn't made of two of the sensors in marker/.
    """
    names = [path.name for path in subfolders(folder / "marker", root)]
    fitting = [pair for pair in permutations(names, 2) if "_".join(pair) == folder.name]
    if len(fitting) != 1:
        wanted = f"marker/ with the two sensors of {folder.name}, of different names"
        raise DatasetError(
            expected(str(folder), wanted, names or "none", "Name them apart: _l, _r.")
        )
    return fitting[0]


def _indenters(pairs: Path, sensors: tuple[str, str], root: Path, config: PairConfig) -> list[str]:
    sides = []
    for sensor in sensors:
        sides.append([path.name for path in subfolders(pairs / "marker" / sensor, root)])
    left, right = sides
    if left != right or not left:
        came = f"{left} on the left, {right} on the right"
        raise DatasetError(
            expected(str(pairs), "the same indenters on both sides", came, "Restore both.")
        )
    unknown = [name for name in config.indenters if name not in left]
    if unknown:
        raise DatasetError(
            expected(f"indenters in {pairs}", " | ".join(left), unknown, "Check the names.")
        )
    return [name for name in left if name in (config.indenters or left)]


def _recordings(
    root: Path, pairs: Path, sensors: tuple[str, str], indenter: str, config: PairConfig
) -> Iterator[PairRecording]:
    left_folder = inside(root, pairs / "marker" / sensors[0] / indenter)
    right_folder = inside(root, pairs / "marker" / sensors[1] / indenter)
    left = numbered_images(left_folder, root, ENDINGS)
    right = numbered_images(right_folder, root, ENDINGS)
    alone = sorted(left.keys() ^ right.keys())
    if alone:
        came = f"{len(alone)} on one side only, e.g. {alone[0]:06d}"
        raise DatasetError(
            expected(f"{pairs}, {indenter}", "the same indices", came, "Same index = pair.")
        )
    left_reference = _reference(left_folder, left, root, config)
    right_reference = _reference(right_folder, right, root, config)
    name = "/".join(pairs.relative_to(root).parts) or pairs.name
    paired = list(zip(left.values(), right.values(), strict=True))
    for start in range(0, len(paired), config.max_frames):
        left_frames = []
        right_frames = []
        for left_path, right_path in paired[start : start + config.max_frames]:
            left_frames.append(read_marker_picture(left_path, HALF_WAY))
            right_frames.append(read_marker_picture(right_path, HALF_WAY))
        yield PairRecording(
            sensors=sensors,
            indenter=indenter,
            name=name,
            left_reference=left_reference,
            right_reference=right_reference,
            left_frames=np.stack(left_frames),
            right_frames=np.stack(right_frames),
            first_frame=start,
        )


def _reference(folder: Path, images: dict[int, Path], root: Path, config: PairConfig) -> np.ndarray:
    for place in (folder / REFERENCE_FILE, folder.parent / REFERENCE_FILE):
        if place.is_file():
            return read_marker_picture(inside(root, place), HALF_WAY)
    if config.reference_index is None:
        do = "If one of the frames was taken without contact, "
        do += "name it: PairConfig(reference_index=0)."
        raise DatasetError(expected(str(folder), REFERENCE_FILE, "none", do))
    if config.reference_index not in images:
        wanted = f"frame {config.reference_index:06d} as reference"
        came = f"{len(images)} others"
        raise DatasetError(expected(str(folder), wanted, came, "Name another."))
    return read_marker_picture(images[config.reference_index], HALF_WAY)


def write_uniforce_pairs(
    root: str | Path, recording: PairRecording, pattern: str, date: str | None = None
) -> Path:
    """Append pairs to the layout and return the ``<left>_<right>`` folder.

    Reading gives the same images back. Frames go on from the last index of their indenter. The
    outermost 4 px become black, as the format has it. The left image of a pair is written last: a
    killed writer leaves at most one right image without its partner.

    Args:
        root: folder of the data set; created where missing.
        recording: images of 480×640 px; its ``first_frame`` and ``name`` are not stored.
        pattern: marker pattern, the first level below ``root``.
        date: second level, e.g. "20260131"; None for today (UTC).

    Raises ContractError: names that are no plain folder names, sensors of one name, or another
    image size; DatasetError: the indenter is there with another reference.
    """
    _check_writable(recording, pattern, date)
    date = date or datetime.now(UTC).strftime("%Y%m%d")
    pairs = Path(root) / pattern / date / "_".join(recording.sensors)
    left_folder = pairs / "marker" / recording.sensors[0] / recording.indenter
    right_folder = pairs / "marker" / recording.sensors[1] / recording.indenter
    _write_reference(left_folder, recording.left_reference)
    _write_reference(right_folder, recording.right_reference)
    there = [int(path.stem) for path in left_folder.glob("*.jpg") if path.stem.isdecimal()]
    start = max(there, default=-1) + 1  # the left side counts: it is written last
    _log(pairs, recording.indenter, f"{len(recording.left_frames)} pairs from {start:06d}")
    for index, (left, right) in enumerate(
        zip(recording.left_frames, recording.right_frames, strict=True), start
    ):
        _write_picture(right_folder / f"{index:06d}.jpg", right)
        _write_picture(left_folder / f"{index:06d}.jpg", left)
    return pairs


def _check_writable(recording: PairRecording, pattern: str, date: str | None) -> None:
    for name in (pattern, date or "today", recording.indenter, *recording.sensors):
        if not name or name.startswith((".", "__")) or name != Path(name).name or "\\" in name:
            raise ContractError(
                expected("folder name", "a plain name", repr(name), "Leave out / and dots.")
            )
    if recording.sensors[0] == recording.sensors[1]:
        do = "Both fingers' images would share a folder: name them apart, e.g. with _l and _r."
        raise ContractError(expected("sensors", "two different names", recording.sensors, do))
    shapes = (recording.left_reference.shape, recording.right_reference.shape)
    if set(shapes) != {MARKER_IMAGE_SHAPE}:
        raise ContractError(
            expected("pair images", MARKER_IMAGE_SHAPE, shapes, "Use the canonical size.")
        )


def bordered(image: np.ndarray) -> np.ndarray:
    """Return a copy of an (…, H, W) image whose outermost 4 px are black."""
    framed = np.zeros_like(image)
    inner = (..., slice(BORDER_PX, -BORDER_PX), slice(BORDER_PX, -BORDER_PX))
    framed[inner] = image[inner]
    return framed


def _write_reference(folder: Path, reference: np.ndarray) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / REFERENCE_FILE
    if not path.exists():
        _write_picture(path, reference)
    elif not np.array_equal(read_marker_picture(path, HALF_WAY), bordered(reference)):
        do = "A sensor that was taken off or retared starts a new date or indenter folder."
        raise DatasetError(expected(str(path), "the reference of this recording", "another", do))


def _write_picture(path: Path, image: np.ndarray) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, 100]
    _, data = cv2.imencode(".jpg", bordered(image), options)
    scratch = path.with_suffix(".tmp")
    scratch.write_bytes(data.tobytes())
    scratch.replace(path)


def _log(pairs: Path, indenter: str, what: str) -> None:
    stamp = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")
    with (pairs / LOG_FILE).open("a") as log:
        log.write(f"{stamp} UTC - [indenter: {indenter}] - {what}\n")
