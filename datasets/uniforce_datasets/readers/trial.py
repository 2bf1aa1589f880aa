"""One recorded trial → recordings: take its free-air reference, make marker images, cut what is too long."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from uniforce_datasets.readers.force_axes import check_compression
from uniforce_datasets.readers.recording import LabelledRecording, check_forces
from uniforce_vtla.errors import DatasetError, SensorError, expected
from uniforce_vtla.markers import Canonicalizer

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReadOptions:
    """What to do where a trial isn't as the protocol promises, and how much to hold in memory."""

    reference: Literal["first", "quietest"] = (
        "first"  # frame taken as free air: a trial begins before contact
    )
    max_reference_force_N: float = (
        0.5  # |F| in that frame; drift of a tared cell, less than any labelled press
    )
    pressed_reference: Literal["refuse", "skip"] = "refuse"  # a trial without such a frame
    unreadable_frame: Literal["refuse", "cut"] = (
        "refuse"  # no markers found: stop, or end the recording there
    )
    max_frames: int = 256  # per recording: 79 MB of images; a longer trial comes in parts


@dataclass(frozen=True, eq=False)
class Trial:
    """Where a trial's frames are, before any is loaded.

    Attributes:
        sensor: kind of sensor.
        indenter: what was pressed.
        name: of the trial.
        force_N: (T, 3) float32 in our axes.
        signal: ``signal(k)`` yields frames k, k + 1, … T − 1: marker images, or raw signals of the sensor.
        canonicalise_as: registry name of the canonicaliser for raw signals; None for marker images.
        free_air: raw signal or marker image known to be free air, where the data set holds one.
    """

    sensor: str
    indenter: str
    name: str
    force_N: np.ndarray
    signal: Callable[[int], Iterator[np.ndarray]]
    canonicalise_as: str | None = None
    free_air: np.ndarray | None = None

    def __str__(self) -> str:
        return f"{self.sensor}/{self.indenter}/{self.name}"


def recordings_of(trial: Trial, options: ReadOptions) -> Iterator[LabelledRecording]:
    """Yield a trial's recordings, at most ``options.max_frames`` frames each.

    Raises:
        DatasetError: no free-air frame, frames that don't match the forces, or forces that pull.
        SensorError: the canonicaliser's own, e.g. no markers; which frame it was stands in its notes.
    """
    check_forces(trial.force_N, len(trial.force_N), str(trial))
    check_compression(trial.force_N, str(trial))
    free_air = _free_air(trial, options)
    if free_air is None:
        return
    pairs = _marker_pairs(trial, free_air, options)
    for start, reference, frames in _parts(pairs, options.max_frames):
        yield LabelledRecording(
            trial.sensor,
            trial.indenter,
            trial.name,
            reference,
            frames,
            trial.force_N[start : start + len(frames)],
            start,
        )


def _free_air(trial: Trial, options: ReadOptions) -> np.ndarray | None:
    if trial.free_air is not None:
        return trial.free_air
    strength = np.linalg.norm(trial.force_N, axis=1)  # (T,)
    index = int(strength.argmin()) if options.reference == "quietest" else 0
    if strength[index] <= options.max_reference_force_N:
        return _frame(trial, index)
    wanted = f"a free-air frame, |F| ≤ {options.max_reference_force_N:g} N"
    came = f"{strength[index]:.2f} N in the {options.reference} frame"
    if options.pressed_reference == "refuse":
        do = 'Leave it out with ReadOptions(pressed_reference="skip"), or raise max_reference_force_N.'
        raise DatasetError(expected(str(trial), wanted, came, do))
    log.warning("%s left out: expected %s, got %s", trial, wanted, came)
    return None


def _frame(trial: Trial, index: int) -> np.ndarray:
    frame = next(trial.signal(index), None)
    if frame is None:
        do = "Frames and forces don't belong together: is a file missing?"
        raise DatasetError(expected(str(trial), f"a frame {index} for the reference", "none", do))
    return frame


Step = tuple[int, np.ndarray, np.ndarray] | None  # index, reference, image; None where a recording must end


def _marker_pairs(trial: Trial, free_air: np.ndarray, options: ReadOptions) -> Iterator[Step]:
    """Yield marker images with their reference, frame by frame; raise where the count differs from the forces'."""
    canonicalizer = Canonicalizer(trial.canonicalise_as) if trial.canonicalise_as else None
    index = -1
    for index, raw in enumerate(trial.signal(0)):
        if canonicalizer is None:
            yield index, free_air, raw
            continue
        try:
            pair = canonicalizer.pair(free_air, raw, "left")  # "left": no finger yet, and nothing is flipped
        except SensorError as error:
            if options.unreadable_frame == "refuse" or index == 0:
                error.add_note(f"in frame {index} of {trial}")
                raise
            log.warning("%s, frame %d left out: %s", trial, index, error)
            yield None
            continue
        yield index, pair.reference, pair.current
    if index + 1 != len(trial.force_N):
        do = "Frames and forces don't belong together: is a file missing?"
        raise DatasetError(expected(str(trial), f"{len(trial.force_N)} frames, one per force", index + 1, do))


def _parts(steps: Iterator[Step], longest: int) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield (index of the first frame, reference, (T, H, W) frames) of runs without a gap."""
    start, reference, images = 0, np.empty(0), list[np.ndarray]()
    for step in steps:
        if images and (step is None or len(images) == longest):
            yield start, reference, _stacked(images)
            images = []
        if step is None:
            continue
        if not images:
            start, reference = step[0], step[1]
        images.append(step[2])
    if images:
        yield start, reference, _stacked(images)


def _stacked(images: list[np.ndarray]) -> np.ndarray:
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise DatasetError(expected("frames of a trial", "one size", sorted(sizes), "Use one setting."))
    return np.stack(images)
