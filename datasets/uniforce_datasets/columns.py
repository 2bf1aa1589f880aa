"""Check one recorded row against the dataset's columns before LeRobot sees it."""

from __future__ import annotations

from typing import Any

import numpy as np

from uniforce_vtla.contracts import check_marker_image
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import TACTILE_KEYS
from uniforce_vtla.sensors import get_sensor, list_sensors


def sensor_index(name: str) -> int:
    """Return the registry index of a sensor; raise SensorError if it is unknown."""
    return list_sensors().index(get_sensor(name).name)


def as_column(key: str, value: Any) -> np.ndarray:
    """Return the value as stored: marker images as (480, 640, 3) with R = G = B, the rest as it came."""
    array = np.asarray(value)
    if key not in TACTILE_KEYS:
        return array
    image = check_marker_image(array if array.ndim == 2 else array[..., 0], key)
    if array.ndim == 3 and not (array == image[..., None]).all():
        raise ContractError(expected(key, "R = G = B", "a coloured image", "Store marker images."))
    return np.repeat(image[..., None], 3, axis=2)


class ColumnMaker:
    """``as_column`` that does a reference, the same array object all episode long, only once."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[Any, np.ndarray]] = {}

    def __call__(self, key: str, value: Any) -> np.ndarray:
        """Return the value as stored; an array that was passed must not be written to afterwards."""
        if key not in TACTILE_KEYS:
            return as_column(key, value)
        last = self._last.get(key)
        if last is None or last[0] is not value:
            last = self._last[key] = (value, as_column(key, value))
        return last[1]


def check_row(row: dict[str, np.ndarray], features: dict[str, dict]) -> None:
    """Raise ContractError for a missing or unknown column, a wrong shape or dtype, NaN or inf."""
    missing, unknown = sorted(features.keys() - row.keys()), sorted(row.keys() - features.keys())
    if missing or unknown:
        came = f"missing {missing}, unknown {unknown}"
        raise ContractError(expected("frame", "the dataset's columns", came, "See dataset_features."))
    for key, value in row.items():
        dtype = "uint8" if features[key]["dtype"] == "video" else features[key]["dtype"]
        if value.shape != tuple(features[key]["shape"]) or value.dtype != dtype:
            wanted, came = f"{features[key]['shape']} {dtype}", f"{value.shape} {value.dtype}"
            raise ContractError(expected(key, wanted, came, "Convert it before add()."))
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise ContractError(expected(key, "finite numbers", "NaN or inf", "Check where it comes from."))
