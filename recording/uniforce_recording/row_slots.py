"""Rows in memory that two processes share: copied in by one, copied out by the other, nothing pickled."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.context import SpawnContext
from typing import Any

import numpy as np

from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE, Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import (
    CAUSE,
    OUTCOME,
    SEED,
    SUCCESS,
    TACTILE_KEYS,
    sensor_key,
    tactile_key,
    tactile_name,
)

ALIGN = 8  # bytes; any number of a row may be read in place
RECORDERS_OWN = {SUCCESS, OUTCOME, SEED, CAUSE, *(sensor_key(finger) for finger in FINGERS)}
REFERENCES = tuple(tactile_key(finger, reference=True) for finger in FINGERS)


@dataclass(frozen=True)
class Field:
    """Where one array of a row lies in its slot."""

    offset: int
    shape: tuple[int, ...]
    dtype: str

    @property
    def size(self) -> int:
        """Bytes."""
        return int(np.prod(self.shape)) * np.dtype(self.dtype).itemsize


class RowSlots:
    """A fixed number of rows; goes into a child process as it is.

    Args:
        features: LeRobot's; a marker image takes one channel, since its three are equal.
        raw_shapes: of raw tactile frames by finger.
        count: rows.
        context: of the child process.
    """

    def __init__(
        self,
        features: Mapping[str, dict[str, Any]],
        raw_shapes: Mapping[Finger, tuple[int, ...]],
        count: int,
        context: SpawnContext,
    ) -> None:
        self.count = count
        self._fields: dict[str, Field] = {}
        self._slot_size = 0
        for key, feature in features.items():
            if key not in RECORDERS_OWN:
                is_video = feature["dtype"] == "video"
                shape = MARKER_IMAGE_SHAPE if key in TACTILE_KEYS else tuple(feature["shape"])
                self._lay(key, shape, "uint8" if is_video else feature["dtype"])
        for finger, shape in raw_shapes.items():
            self._lay(_raw(finger), shape, "uint8")
        self._raw_fingers = tuple(raw_shapes)
        self._memory = context.RawArray(ctypes.c_uint8, self._slot_size * count)

    def write(
        self, slot: int, row: Mapping[str, Any], raw: Mapping[Finger, np.ndarray], known: set[str]
    ) -> None:
        """Copy a row into a slot.

        Args:
            slot: a free one.
            row: every column but the recorder's own.
            raw: raw frames by finger.
            known: keys the reader has already and keeps; they are left out.

        Raises:
            ContractError: a key missing or too many, another shape or dtype.
        """
        whole = {**row, **{_raw(finger): frame for finger, frame in raw.items()}}
        if whole.keys() != self._fields.keys():
            odd = sorted(whole.keys() ^ self._fields.keys())
            raise ContractError(expected("frame", "the dataset's columns", f"others: {odd}", "See rows.py."))
        for key, value in whole.items():
            if key not in known:
                self._write_one(slot, key, np.asarray(value))

    def read(self, slot: int, known: set[str]) -> tuple[dict[str, np.ndarray], dict[Finger, np.ndarray]]:
        """Return (row, raw) of a slot: pictures in place, valid until it is written again, numbers copied."""
        row = {key: self._read_one(slot, key) for key in self._fields if key not in known}
        raw = {finger: row.pop(_raw(finger)) for finger in self._raw_fingers}
        return row, raw

    def _lay(self, key: str, shape: tuple[int, ...], dtype: str) -> None:
        field = Field(self._slot_size, shape, dtype)
        self._fields[key] = field
        self._slot_size += -(-field.size // ALIGN) * ALIGN

    def _write_one(self, slot: int, key: str, value: np.ndarray) -> None:
        field = self._fields[key]
        if value.shape != field.shape or value.dtype != field.dtype:
            wanted, came = f"{field.shape} {field.dtype}", f"{value.shape} {value.dtype}"
            raise ContractError(expected(key, wanted, came, "Convert it before add()."))
        np.copyto(self._view(slot, field), value)

    def _read_one(self, slot: int, key: str) -> np.ndarray:
        field = self._fields[key]
        view = self._view(slot, field)
        keeps = key in REFERENCES or len(field.shape) == 1
        return view.copy() if keeps else view

    def _view(self, slot: int, field: Field) -> np.ndarray:
        begin = slot * self._slot_size + field.offset
        flat = np.frombuffer(self._memory, np.uint8, field.size, begin)
        return flat.view(field.dtype).reshape(field.shape)


def _raw(finger: Finger) -> str:
    return f"raw frame {tactile_name(finger)}"
