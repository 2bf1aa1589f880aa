"""The columns of a recorded demonstration: what LeRobot v3 is told to store.

Scene cameras and marker images are videos; truth and provenance are per-frame numbers, because LeRobot's delete
and split drop per-episode columns, and they carry no ``observation.`` prefix, so that no policy ever reads them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE
from uniforce_vtla.keys import (
    ACTION,
    AXES,
    CAMERAS,
    OUTCOME,
    SEED,
    STATE,
    SUCCESS,
    TACTILE_KEYS,
    age_key,
    camera_key,
    sensor_key,
    time_key,
    truth_wrench_key,
)

CAMERA_SHAPE = (224, 224, 3)  # rows, columns, RGB
MARKER_VIDEO_SHAPE = (*MARKER_IMAGE_SHAPE, 3)  # R = G = B: LeRobot has no one-channel cameras
WRENCH_AXES = ("fx_N", "fy_N", "fz_N", "torsion_Nmm")


def _video(shape: tuple[int, int, int]) -> dict[str, Any]:
    return {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}


def _vector(names: Sequence[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}


def _scalar(dtype: str) -> dict[str, Any]:
    return {"dtype": dtype, "shape": (1,), "names": None}


def dataset_features(
    camera_shape: tuple[int, int, int] = CAMERA_SHAPE, truth: bool = True
) -> dict[str, dict]:
    """Return LeRobot's features dict.

    Args:
        camera_shape: (rows, columns, 3) of both scene cameras.
        truth: whether the true pad wrench is known (simulation) and stored.
    """
    features = {camera_key(camera): _video(camera_shape) for camera in CAMERAS}
    features |= {key: _video(MARKER_VIDEO_SHAPE) for key in TACTILE_KEYS}
    features |= {STATE: _vector(AXES), ACTION: _vector(AXES)}
    if truth:
        features |= {truth_wrench_key(finger): _vector(WRENCH_AXES) for finger in FINGERS}
    for finger in FINGERS:
        features[sensor_key(finger)] = _scalar("int64")  # index into sensors.list_sensors()
        features[time_key(finger)] = _scalar("float64")
        features[age_key(finger)] = _scalar("float32")
    return features | {SUCCESS: _scalar("float32"), OUTCOME: _scalar("int64"), SEED: _scalar("int64")}
