"""One tick as a row of the dataset, and the columns it needs beside the usual ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from uniforce_datasets.features import flat_column, scalar_column, vector_column
from uniforce_recording.observation import FingerTouch, Observation
from uniforce_recording.rig import RigFacts
from uniforce_vtla.contracts import TAXEL_SHAPE, Finger
from uniforce_vtla.keys import (
    ACTION,
    AXES,
    CAUSE,
    REQUESTED,
    STAMP_NAMES,
    STAMPS,
    STATE,
    age_key,
    camera_key,
    counts_key,
    index_key,
    tactile_key,
    time_key,
    window_key,
    window_time_key,
)

TAXEL_NUMBERS = int(np.prod(TAXEL_SHAPE))


def further_columns(facts: RigFacts) -> dict[str, dict[str, Any]]:
    """Return the features of all columns a rig needs beside ``dataset_features``' own."""
    columns: dict[str, dict[str, Any]] = {
        REQUESTED: vector_column(AXES),
        STAMPS: vector_column(STAMP_NAMES, "float64"),
        CAUSE: scalar_column("int64"),
    }
    for camera in facts.cameras:
        columns |= {time_key(camera): scalar_column("float64"), age_key(camera): scalar_column("float32")}
    columns |= {index_key(source): scalar_column("int64") for source in (*facts.cameras, *facts.sensors)}
    for finger, size in facts.windows.items():
        columns[counts_key(finger)] = flat_column(TAXEL_NUMBERS, "int32")
        columns[window_key(finger)] = flat_column(size * TAXEL_NUMBERS, "int32")
        columns[window_time_key(finger)] = flat_column(size, "float64")
    return columns | facts.measured


def make_row(
    seen: Observation, requested: np.ndarray, sent: np.ndarray, stamps_s: tuple[float, ...], begun_s: float
) -> dict[str, Any]:
    """Return a row for ``EpisodeRecorder.add``.

    Args:
        seen: what was observed.
        requested: (5,) what the teleoperator asked for.
        sent: (5,) what went to the robot.
        stamps_s: one time per ``keys.STAMP_NAMES``, rig's clock.
        begun_s: when the episode began; times are stored relative to it.
    """
    row: dict[str, Any] = {
        STATE: seen.axes.astype(np.float32),
        ACTION: sent.astype(np.float32),
        REQUESTED: requested.astype(np.float32),
        STAMPS: np.array(stamps_s) - begun_s,
        **seen.measured,
    }
    for camera, picture in seen.cameras.items():
        row[camera_key(camera)] = picture.image
        row |= _when(camera, picture.index, picture.time_s, seen.time_s, begun_s)
    for finger, touch in seen.fingers.items():
        row |= _touch(finger, touch, begun_s)
        row |= _when(finger, touch.index, touch.time_s, seen.time_s, begun_s)
    return row


def raw_frames(seen: Observation) -> dict[Finger, np.ndarray]:
    """Return the raw camera frames of an observation by finger."""
    return {
        f: touch.raw for f, touch in seen.fingers.items() if touch.raw is not None and touch.window is None
    }


def _when(
    source: str, index: int, taken_s: float, observed_s: float, begun_s: float
) -> dict[str, np.ndarray]:
    return {
        index_key(source): np.array([index]),
        time_key(source): np.array([taken_s - begun_s]),
        age_key(source): np.array([observed_s - taken_s], dtype=np.float32),
    }


def _touch(finger: Finger, touch: FingerTouch, begun_s: float) -> dict[str, np.ndarray]:
    row = {tactile_key(finger): touch.image, tactile_key(finger, reference=True): touch.reference}
    if touch.window is None or touch.raw is None:
        return row
    return row | {
        counts_key(finger): touch.raw.reshape(-1).astype(np.int32),
        window_key(finger): touch.window.scans.reshape(-1).astype(np.int32),
        window_time_key(finger): touch.window.times_s - begun_s,
    }
