"""Opening what users bring: only inside the folder they named, never unpickled, whole or not at all."""

from collections.abc import Iterable
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
    """Return what fits ``pattern`` in ``root`` or up to three levels below, none of it leading outside."""
    levels = ("", "*/", "*/*/", "*/*/*/")
    return sorted(inside(root, path) for level in levels for path in root.glob(level + pattern))


def subfolders(folder: Path, root: Path) -> list[Path]:
    """Return the sorted folders in ``folder``, hidden ones left out, none leading outside ``root``."""
    if not folder.is_dir():
        return []
    return [
        inside(root, p)
        for p in sorted(folder.iterdir())
        if p.is_dir() and not p.name.startswith((".", "__"))
    ]


def numbered_images(folder: Path, root: Path, endings: Iterable[str]) -> list[Path]:
    """Return images called by a number, in its order.

    Raises DatasetError: none, several kinds of file, the same number twice, or one leading outside ``root``.
    """
    kinds = tuple(endings)
    found = [p for p in folder.iterdir() if p.suffix.lower() in kinds and p.stem.isdecimal()]
    wanted = f"images like 000000{' or 000000'.join(kinds)}"
    if not found:
        raise DatasetError(expected(str(folder), wanted, "none", "Is the data set complete?"))
    if len({p.suffix for p in found}) > 1 or len({int(p.stem) for p in found}) < len(found):
        came = ", ".join(sorted(p.name for p in found)[:4]) + " …"
        raise DatasetError(
            expected(str(folder), f"one kind of {wanted}", came, "Which belong together?")
        )
    return [inside(root, p) for p in sorted(found, key=lambda p: int(p.stem))]


def read_marker_picture(path: Path, threshold: int) -> np.ndarray:
    """Return a (480, 640) uint8 marker image from a JPEG or PNG of one, white above ``threshold``.

    Raises DatasetError: unreadable, truncated, of another size, or not a black-and-white picture.
    """
    picture = decode_picture(read_bytes(path), str(path), colour=False)
    if picture.shape != MARKER_IMAGE_SHAPE:
        raise DatasetError(
            expected(str(path), MARKER_IMAGE_SHAPE, picture.shape, "Rows × columns of it?")
        )
    middle = float(((picture >= MIDDLE[0]) & (picture <= MIDDLE[1])).mean())
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


def decode_picture(data: bytes, where: str, colour: bool) -> np.ndarray:
    """Return (H, W, 3) RGB or (H, W) grey uint8 of an encoded picture.

    Raises DatasetError: no picture, or a truncated one, which decoders fill with grey in silence.
    """
    tail = _ENDS.get(data[:2])
    whole = bool(data) and (tail is None or data.rstrip(b"\0")[-len(tail) :] == tail)
    flag = cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), flag) if whole else None
    if picture is None:
        came = "something else" if whole else "an empty or truncated one"
        raise DatasetError(expected(where, "a whole JPEG or PNG", came, "Restore it from a copy."))
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB) if colour else picture


def read_table(path: Path) -> pd.DataFrame:
    """Return a csv table, its numbers exactly as written; raise DatasetError where there is none."""
    if not path.is_file():
        raise DatasetError(expected(str(path), "a csv file", "none", "Is the data set complete?"))
    try:
        return pd.read_csv(path, float_precision="round_trip")
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise DatasetError(
            expected(str(path), "a csv table", error, "Restore it from a copy.")
        ) from error
