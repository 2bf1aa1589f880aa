"""The columns of a recorded demonstration: the features that LeRobot v3 stores.

Scene cameras and marker images are videos. Truth and provenance are per-frame numbers, because
LeRobot's delete and split drop per-episode columns; they carry no ``observation.`` prefix, so that
no policy ever reads them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from lerobot.utils.constants import DEFAULT_FEATURES

from uniforce_vtla import keys
from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE, check_marker_image
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.sensors import get_sensor, list_sensors

CAMERA_SHAPE = (224, 224, 3)  # rows, columns, RGB
MARKER_VIDEO_SHAPE = (*MARKER_IMAGE_SHAPE, 3)  # R = G = B: LeRobot has no one-channel cameras
WRENCH_AXES = ("fx_N", "fy_N", "fz_N", "torsion_Nmm")
Shape = tuple[int, int, int]


def video_column(shape: Shape) -> dict[str, Any]:
    """Return the feature of a video of (rows, columns, 3) frames."""
    return {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}


def vector_column(names: Sequence[str], dtype: str = "float32") -> dict[str, Any]:
    """Return the feature of a per-frame vector with a name per number."""
    return {"dtype": dtype, "shape": (len(names),), "names": list(names)}


def flat_column(size: int, dtype: str) -> dict[str, Any]:
    """Return the feature of a per-frame vector without names; LeRobot takes no more axes."""
    return {"dtype": dtype, "shape": (size,), "names": None}


def scalar_column(dtype: str) -> dict[str, Any]:
    """Return the feature of one number per frame."""
    return flat_column(1, dtype)


def dataset_features(
    cameras: Shape | Mapping[str, Shape] = CAMERA_SHAPE,
    truth: bool = True,
    further: Mapping[str, dict[str, Any]] | None = None,
) -> dict[str, dict]:
    """Return LeRobot's features dict.

    Args:
        cameras: (rows, columns, 3) by scene camera, or one shape for the two of ``keys.CAMERAS``.
        truth: whether the true pad wrench is known (simulation) and stored.
        further: columns a robot stores beside these, by key.
    """
    if not isinstance(cameras, Mapping):
        cameras = dict.fromkeys(keys.CAMERAS, cameras)
    features = {keys.camera_key(camera): video_column(shape) for camera, shape in cameras.items()}
    for key in keys.TACTILE_KEYS:
        features[key] = video_column(MARKER_VIDEO_SHAPE)
    features[keys.STATE] = vector_column(keys.AXES)
    features[keys.ACTION] = vector_column(keys.AXES)
    for finger in FINGERS:
        if truth:
            features[keys.truth_wrench_key(finger)] = vector_column(WRENCH_AXES)
        # index into sensors.list_sensors()
        features[keys.sensor_key(finger)] = scalar_column("int64")
        features[keys.time_key(finger)] = scalar_column("float64")
        features[keys.age_key(finger)] = scalar_column("float32")
    features[keys.SUCCESS] = scalar_column("float32")
    features[keys.OUTCOME] = scalar_column("int64")
    features[keys.SEED] = scalar_column("int64")
    return features | dict(further or {})


def refuse_other_features(meta: Any, fps: int, features: Mapping[str, dict[str, Any]]) -> None:
    """Refuse to go on with a dataset of other columns.

    Args:
        meta: LeRobot's metadata of the dataset.
        fps: to record at.
        features: to record.

    Raises DatasetError: a column is missing, too many, or of another form; another rate.
    """
    stored = meta.features
    odd = set(features.keys() ^ stored.keys()) - DEFAULT_FEATURES.keys()
    for key in features.keys() & stored.keys():
        if features[key]["dtype"] != stored[key]["dtype"]:
            odd.add(key)
        if list(features[key]["shape"]) != list(stored[key]["shape"]):
            odd.add(key)
    if odd or meta.fps != fps:
        others = f"others: {sorted(odd) or f'{meta.fps} fps'}"
        do = "Record into another root."
        raise DatasetError(expected("dataset", "the features to record", others, do))


def sensor_index(name: str) -> int:
    """Return the registry index of a sensor; raise SensorError if it is unknown."""
    return list_sensors().index(get_sensor(name).name)


class ColumnMaker:
    """Makes columns of values; a marker image that equals the last one is made only once."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def __call__(self, key: str, value: Any) -> np.ndarray:
        """Return the value as stored: marker images as (480, 640, 3) with R = G = B.

        It shares no memory with ``value``: a driver may fill one array over and over.
        """
        array = np.array(value)
        if key not in keys.TACTILE_KEYS:
            return array
        if key not in self._last or not np.array_equal(self._last[key][0], array):
            image = array if array.ndim == 2 else np.ascontiguousarray(array[..., 0])
            check_marker_image(image, key)
            # np.repeat takes twenty times as long
            stored = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
            if array.ndim > 2 and (array != image[..., None]).any():
                do = "Store marker images."
                raise ContractError(expected(key, "R = G = B", "a coloured image", do))
            self._last[key] = (array, stored)
        return self._last[key][1]


def check_row(row: dict[str, np.ndarray], features: dict[str, dict]) -> None:
    """Raise ContractError for a missing or unknown column, a wrong shape or dtype, NaN or inf."""
    if row.keys() != features.keys():
        missing = sorted(features.keys() - row.keys())
        unknown = sorted(row.keys() - features.keys())
        came = f"missing {missing}, unknown {unknown}"
        raise ContractError(
            expected("frame", "the dataset's columns", came, "See dataset_features.")
        )
    for key, value in row.items():
        shape = features[key]["shape"]
        dtype = features[key]["dtype"].replace("video", "uint8")
        if value.shape != tuple(shape) or value.dtype != dtype:
            came = f"{value.shape} {value.dtype}"
            do = "Convert it before add()."
            raise ContractError(expected(key, f"{shape} {dtype}", came, do))
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise ContractError(
                expected(key, "finite numbers", "NaN or inf", "Check where it comes from.")
            )
