"""Films of a tactile camera: videos, or frames saved with numpy.save as (T, H, W, 3) uint8 RGB."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import av
import numpy as np

from uniforce_datasets.source import opened_video
from uniforce_vtla.array_file import read_array
from uniforce_vtla.errors import DatasetError, expected


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
