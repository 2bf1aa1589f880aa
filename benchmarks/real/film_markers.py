"""Markers of a recorded film, frame by frame, to find its free frame (``free_frame.pads``)."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers.canonicalizer import Canonicalizer

SETTLE = 10  # frames until a camera's exposure holds: up to a quarter darker before
STEP = 5  # frames between two that are read; a fifth of a second at 25 Hz


@dataclass(frozen=True)
class FilmMarkers:
    """Markers of those frames of a film that could be read, of every fifth once exposure holds."""

    numbers: tuple[int, ...]  # of the frames read, counted from the film's first
    centres_px: tuple[np.ndarray, ...]  # of each (M, 2), in px of the canonical image
    refused: dict[int, str]  # frame → why it couldn't be read


def read_markers(frames: Iterable[np.ndarray], sensor: str) -> FilmMarkers:
    """Return the markers of a film's (H, W, 3) uint8 RGB frames.

    The first readable frame decides how markers appear.

    Raises ContractError: frames of a wrong form, or an unknown sensor.
    """
    canonicalizer = Canonicalizer(sensor, register=False)
    centres_px: dict[int, np.ndarray] = {}
    refused: dict[int, str] = {}
    for number, frame in islice(enumerate(frames), SETTLE, None, STEP):
        try:
            if not centres_px:
                canonicalizer.set_reference(frame)  # how markers appear; not where they are
            centres_px[number] = canonicalizer.markers(frame)
        except SensorError as error:
            refused[number] = str(error)
    return FilmMarkers(tuple(centres_px), tuple(centres_px.values()), refused)
