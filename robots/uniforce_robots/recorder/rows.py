"""One tick as a row of the dataset, its further columns, and shared memory for rows.

Rows go to the storing process through that memory: nothing is pickled.
"""

import ctypes
from collections.abc import Mapping
from multiprocessing.context import SpawnContext
from typing import Any

import numpy as np

from uniforce_datasets.features import dataset_features, flat_column, scalar_column, vector_column
from uniforce_robots.recorder.rig import FingerTouch, Observation, RigFacts
from uniforce_vtla import keys
from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE, TAXEL_SHAPE, Finger
from uniforce_vtla.errors import ContractError, expected

TAXEL_NUMBERS = int(np.prod(TAXEL_SHAPE))
RECORDERS_OWN = {
    keys.SUCCESS,
    keys.OUTCOME,
    keys.SEED,
    keys.CAUSE,
    *(keys.sensor_key(finger) for finger in FINGERS),
}


def further_columns(facts: RigFacts) -> dict[str, dict[str, Any]]:
    """Return the features of all columns a rig needs beside ``dataset_features``' own.

    Raises ContractError: a scene camera whose columns would be those of a finger.
    """
    taken = {*FINGERS, *keys.TACTILE_NAMES} & facts.cameras.keys()
    if taken:
        came = ", ".join(sorted(taken))
        do = "These name the fingers' columns: rename the scene camera, e.g. left_side."
        raise ContractError(expected("cameras", "other names", came, do))
    columns: dict[str, dict[str, Any]] = {
        keys.REQUESTED: vector_column(keys.AXES),
        keys.STAMPS: vector_column(keys.STAMP_NAMES, "float64"),
        keys.CAUSE: scalar_column("int64"),
    }
    for camera in facts.cameras:
        columns[keys.time_key(camera)] = scalar_column("float64")
        columns[keys.age_key(camera)] = scalar_column("float32")
    for source in (*facts.cameras, *facts.sensors):
        columns[keys.index_key(source)] = scalar_column("int64")
    for finger, size in facts.windows.items():
        columns[keys.counts_key(finger)] = flat_column(TAXEL_NUMBERS, "int32")
        columns[keys.window_key(finger)] = flat_column(size * TAXEL_NUMBERS, "int32")
        columns[keys.window_time_key(finger)] = flat_column(size, "float64")
    return columns | facts.measured


def rig_features(facts: RigFacts) -> dict[str, dict[str, Any]]:
    """Return LeRobot's features dict of what a rig's dataset holds."""
    return dataset_features(facts.cameras, facts.simulated, further_columns(facts))


def make_row(
    seen: Observation,
    requested: np.ndarray,
    sent: np.ndarray,
    stamps_s: tuple[float, ...],
    begun_s: float,
) -> dict[str, Any]:
    """Return a row for ``EpisodeRecorder.add``.

    ``requested`` (5,) is the teleoperator's target, ``sent`` (5,) the robot's. ``stamps_s`` has one
    time per ``keys.STAMP_NAMES``. Times are on the rig's clock, and stored relative to ``begun_s``.
    """
    row: dict[str, Any] = {
        keys.STATE: seen.axes.astype(np.float32),
        keys.ACTION: sent.astype(np.float32),
        keys.REQUESTED: requested.astype(np.float32),
        keys.STAMPS: np.array(stamps_s) - begun_s,
        **seen.measured,
    }
    for camera, picture in seen.cameras.items():
        row[keys.camera_key(camera)] = picture.image
    for finger, touch in seen.fingers.items():
        row |= _touch(finger, touch, begun_s)
    for source, sample in seen.samples.items():
        row[keys.index_key(source)] = np.array([sample.index])
        row[keys.time_key(source)] = np.array([sample.time_s - begun_s])
        row[keys.age_key(source)] = np.array([seen.time_s - sample.time_s], dtype=np.float32)
    return row


def raw_frames(seen: Observation) -> dict[Finger, np.ndarray]:
    """Return the raw camera frames of an observation by finger."""
    return {f: t.raw for f, t in seen.fingers.items() if t.raw is not None and t.window is None}


def _touch(finger: Finger, touch: FingerTouch, begun_s: float) -> dict[str, np.ndarray]:
    row = {
        keys.tactile_key(finger): touch.image,
        keys.tactile_key(finger, reference=True): touch.reference,
    }
    if touch.raw is None or touch.window is None or touch.window_times_s is None:
        return row
    return row | {
        keys.counts_key(finger): touch.raw.reshape(-1).astype(np.int32),
        keys.window_key(finger): touch.window.reshape(-1).astype(np.int32),
        keys.window_time_key(finger): touch.window_times_s - begun_s,
    }


class RowSlots:
    """``count`` rows in shared memory, which go into a child process as they are.

    A marker image takes one channel, since its three are equal.
    """

    def __init__(self, facts: RigFacts, count: int, context: SpawnContext) -> None:
        features = rig_features(facts)
        form = {
            key: _form(key, feature)
            for key, feature in features.items()
            if key not in RECORDERS_OWN
        }
        form |= {_raw(finger): ("u1", shape) for finger, shape in facts.raw_frames.items()}
        self._dtype = np.dtype([(key, *kind) for key, kind in form.items()], align=True)
        self._memory = context.RawArray(ctypes.c_uint8, self._dtype.itemsize * count)
        self._raw_fingers = tuple(facts.raw_frames)

    def _slot(self, slot: int) -> dict[str, np.ndarray]:
        slots = np.frombuffer(self._memory, self._dtype)
        return {key: slots[key][slot] for key in self._dtype.names or ()}

    def write(self, slot: int, row: Mapping[str, Any], raw: Mapping[Finger, np.ndarray]) -> None:
        """Copy a row, every column but the recorder's own, and raw frames by finger into a slot.

        Raises ContractError: a key missing or too many, another shape or dtype.
        """
        whole = dict(row)
        for finger, frame in raw.items():
            whole[_raw(finger)] = frame
        places = self._slot(slot)
        odd = sorted(whole.keys() ^ places.keys())
        if odd:
            raise ContractError(
                expected("frame", "the dataset's columns", f"others: {odd}", "See rows.py.")
            )
        for key, place in places.items():
            value = np.asarray(whole[key])
            if value.shape != place.shape or value.dtype != place.dtype:
                wanted = f"{place.shape} {place.dtype}"
                came = f"{value.shape} {value.dtype}"
                raise ContractError(expected(key, wanted, came, "Convert it before add()."))
            np.copyto(place, value)

    def read(self, slot: int) -> tuple[dict[str, np.ndarray], dict[Finger, np.ndarray]]:
        """Return (row, raw) of a slot, in place: valid until it is written again."""
        row = self._slot(slot)
        raw = {finger: row.pop(_raw(finger)) for finger in self._raw_fingers}
        return row, raw


def _form(key: str, feature: Mapping[str, Any]) -> tuple[str, tuple[int, ...]]:
    shape = MARKER_IMAGE_SHAPE if key in keys.TACTILE_KEYS else tuple(feature["shape"])
    return "u1" if feature["dtype"] == "video" else feature["dtype"], shape


def _raw(finger: Finger) -> str:
    return f"raw frame {keys.tactile_name(finger)}"
