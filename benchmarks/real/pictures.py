"""Pictures and films of camera sensors: how many markers are found, and how many of the first frame's later on."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers.canonicalizer import Canonicalizer

STILLS, FILMS = (".png", ".jpg"), (".mp4", ".avi", ".mov")


def is_pictures(folder: Path) -> bool:
    """Return whether ``folder`` holds pictures or films."""
    return any(path.suffix.lower() in STILLS + FILMS for path in folder.iterdir())


def marker_counts(folder: Path, sensor: str, frames: int) -> dict[str, Any]:
    """Return markers found per frame of each film, and of all stills; what is refused is counted too."""
    films = sorted(path for path in folder.iterdir() if path.suffix.lower() in FILMS)
    stills = sorted(path for path in folder.iterdir() if path.suffix.lower() in STILLS)
    found = {film.name: _counted(_film(film, frames), sensor) for film in films}
    return found | ({"stills": _counted((_still(path) for path in stills[:frames]), sensor)} if stills else {})


def _counted(pictures: Iterator[np.ndarray], sensor: str) -> dict[str, Any]:
    counts, refused, canonicalizer = [], 0, Canonicalizer(sensor)
    for picture in pictures:
        try:
            counts.append(len(canonicalizer.markers(picture)))
        except SensorError:
            refused += 1
    spread = np.quantile(counts, (0.1, 0.5, 0.9)).tolist() if counts else []
    return {"frames": len(counts) + refused, "refused": refused, "markers_10_50_90": spread}


def _film(path: Path, frames: int) -> Iterator[np.ndarray]:
    with av.open(str(path)) as film:
        for number, frame in enumerate(film.decode(video=0)):
            if number == frames:
                return
            yield frame.to_ndarray(format="rgb24")


def _still(path: Path) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
