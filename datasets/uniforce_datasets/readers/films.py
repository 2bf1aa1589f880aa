"""Films of a tactile camera: videos, or frames saved with numpy.save as (T, H, W, 3) uint8 RGB."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import av
import numpy as np

from uniforce_datasets.readers.files import existing_folder, find
from uniforce_datasets.source import opened_video
from uniforce_vtla.array_file import read_array
from uniforce_vtla.errors import DatasetError, expected

ENDINGS = (".avi", ".mp4", ".npy")


def find_films(folder: str | Path) -> dict[Path, str]:
    """Return path → object of every film at or up to three levels below ``folder``, sorted.

    The first folder below ``folder`` names the object; a film outside any is an object of its own.

    Raises DatasetError: no folder, no film in it, or a path that leads outside.
    """
    root = existing_folder(folder)
    paths: list[Path] = []
    for ending in ENDINGS:
        paths += find(root, f"*{ending}")
    if not paths:
        wanted = f"films ({', '.join(ENDINGS)}), each in a folder named after the object"
        raise DatasetError(expected(str(root), wanted, "none", "Name the folder of one session."))
    return {path: path.relative_to(root).with_suffix("").parts[0] for path in sorted(paths)}


def film_frames(path: Path) -> Iterator[np.ndarray]:
    """Yield the (H, W, 3) uint8 RGB frames of a film; DatasetError: it can't be read."""
    if path.suffix == ".npy":
        yield from _stacked_frames(path)
        return
    with opened_film(path) as film:
        for frame in film.decode(video=0):
            yield frame.to_ndarray(format="rgb24")


def opened_film(path: Path) -> AbstractContextManager[av.container.InputContainer]:
    """Open a video; DatasetError: it is broken, there or while it is read."""
    return opened_video(path, "a whole film", "Restore it from a copy.")


def _stacked_frames(path: Path) -> Iterator[np.ndarray]:
    stack = read_array(path, mapped=True)
    if stack.ndim != 4 or stack.shape[3] != 3 or stack.dtype != np.uint8:
        came = f"{stack.dtype} {stack.shape}"
        raise DatasetError(
            expected(str(path), "(T, H, W, 3) uint8 RGB", came, "Save the camera's own frames.")
        )
    yield from map(np.array, stack)
