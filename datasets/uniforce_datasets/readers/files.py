"""Open files of users: inside the folder they named, never unpickled, whole or not at all."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from uniforce_datasets.dataset_info import inside
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.options import absolute

MIDDLE = (64, 192)  # grey levels that JPEG rings of a binary image don't reach, but for edges
MAX_MIDDLE_SHARE = 0.05  # of pixels; the antialiased edges of 16 large discs make 2 %
_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}  # how JPEG and PNG begin and end


def existing_folder(folder: str | Path) -> Path:
    """Return ``folder`` as a path; raise DatasetError where it is none."""
    path = absolute(folder)
    if not path.is_dir():
        raise DatasetError(expected("data set", "a folder", f"none at {path}", "Check the path."))
    return path


def find(root: Path, pattern: str) -> list[Path]:
    """Return the paths that fit ``pattern`` up to three levels below ``root``, none outside it."""
    found: list[Path] = []
    for level in ("", "*/", "*/*/", "*/*/*/"):
        for path in root.glob(level + pattern):
            found.append(inside(root, path))
    return sorted(found)


def subfolders(folder: Path, root: Path) -> list[Path]:
    """Return the sorted folders in ``folder``, without hidden ones, none outside ``root``."""
    found = []
    for path in sorted(folder.glob("*")):
        if path.is_dir() and not path.name.startswith((".", "__")):
            found.append(inside(root, path))
    return found


def numbered_images(folder: Path, root: Path, endings: Sequence[str]) -> dict[int, Path]:
    """Return images called by a number, by this number in its order.

    Raises DatasetError: none, several kinds of file, the same number twice, or one leading outside
    ``root``.
    """
    images: dict[int, Path] = {}
    names = []
    suffixes = set()
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in endings and path.stem.isdecimal():
            images[int(path.stem)] = inside(root, path)
            names.append(path.name)
            suffixes.add(path.suffix)
    wanted = f"images like 000000{' or 000000'.join(endings)}"
    if not images:
        raise DatasetError(expected(str(folder), wanted, "none", "Is the data set complete?"))
    if len(suffixes) > 1 or len(images) < len(names):
        came = ", ".join(names[:4]) + " …"
        raise DatasetError(
            expected(str(folder), f"one kind of {wanted}", came, "Which belong together?")
        )
    return dict(sorted(images.items()))


def read_marker_picture(path: Path, threshold: int) -> np.ndarray:
    """Return a (480, 640) uint8 marker image from a JPEG or PNG of one, white above ``threshold``.

    Raises DatasetError: unreadable, truncated, of another size, or not a black-and-white picture.
    """
    picture = decode_picture(read_bytes(path), str(path))
    if picture.shape != MARKER_IMAGE_SHAPE:
        raise DatasetError(
            expected(str(path), MARKER_IMAGE_SHAPE, picture.shape, "Rows × columns of it?")
        )
    lowest, highest = MIDDLE
    middle = float(((picture >= lowest) & (picture <= highest)).mean())
    if middle > MAX_MIDDLE_SHARE:
        do = "This is no marker image: raw camera frames need another reader."
        raise DatasetError(expected(str(path), "black and white", f"{middle:.0%} grey pixels", do))
    return np.where(picture > threshold, 255, 0).astype(np.uint8)


def read_bytes(path: Path) -> bytes:
    """Return a file's content; raise DatasetError where it can't be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(
            expected(str(path), "a readable file", error, "Restore it from a copy.")
        ) from error


def decode_picture(data: bytes, where: str) -> np.ndarray:
    """Return (H, W) grey uint8 of an encoded picture.

    Raises DatasetError: no picture, or a truncated one, which decoders fill with grey in silence.
    """
    came = "an empty or truncated one"
    picture = None
    if data and data.rstrip(b"\0").endswith(_ENDS.get(data[:2], b"")):
        came = "something else"
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise DatasetError(expected(where, "a whole JPEG or PNG", came, "Restore it from a copy."))
    return picture


def read_table(path: Path) -> pd.DataFrame:
    """Return a csv table, its numbers exactly as written; DatasetError: there is none."""
    if not path.is_file():
        raise DatasetError(expected(str(path), "a csv file", "none", "Is the data set complete?"))
    try:
        return pd.read_csv(path, float_precision="round_trip")
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise DatasetError(
            expected(str(path), "a csv table", error, "Restore it from a copy.")
        ) from error
