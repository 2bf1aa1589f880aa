"""A chain of Dynamixel motors on a serial port, asked for its positions over and over. Never run on hardware."""

from __future__ import annotations

import contextlib
import struct
import termios
import time

import numpy as np
import serial

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.samples import now_ns
from uniforce_robots.sensors.sources import SourceCounts, Stamped
from uniforce_robots.teleop.dynamixel import COUNTS_PER_TURN, POSITION_BYTES, StatusReader, sync_read
from uniforce_vtla.errors import expected

ANSWER_S = 0.03  # eight answers of 15 bytes take 21 ms at 57,600 baud, 1.2 ms at 1 M
READ_TIMEOUT_S = 0.005
FAILED_IN_A_ROW = 5
REST_S = 0.002  # between two questions, so that a fast bus doesn't take a core: some 200 Hz
_BROKEN = (OSError, termios.error, TypeError)  # TypeError: pyserial's descriptor vanished while it read


class GelloBus:
    """A ``SampleSource`` of motor angles (N,) rad, in the order of ``ids``; a reading without all motors is dropped."""

    def __init__(self, port: str, ids: tuple[int, ...], baud: int) -> None:
        self.name = f"gello ({port})"
        self._port, self._ids, self._baud = port, tuple(ids), baud
        self._reader = StatusReader()
        self._serial: serial.Serial | None = None
        self._samples = self._lost = self._failed_in_a_row = 0

    @property
    def counts(self) -> SourceCounts:
        """Whole readings, incomplete readings, broken packets."""
        return SourceCounts(self._samples, self._lost, self._reader.bad)

    def open(self) -> None:
        """Open the port for ourselves.

        Raises:
            LostSensorError: no such port, or it is in use.
        """
        self._failed_in_a_row = 0
        try:
            self._serial = serial.Serial(
                self._port, self._baud, timeout=READ_TIMEOUT_S, write_timeout=ANSWER_S, exclusive=True
            )
        except (*_BROKEN, ValueError) as error:
            do = "Check the cable, permissions (group dialout), and that no other program holds it."
            raise LostSensorError(expected(self.name, "a serial port", error, do)) from error

    def read(self) -> list[Stamped]:
        """Ask once; return the angles if every motor answered.

        Raises:
            LostSensorError: the port is gone, or nobody answers.
            ProtocolError: broken packets, or some motor missing, several times in a row.
        """
        if self._serial is None:
            raise LostSensorError(expected(self.name, "an open port", "closed", "Call open()."))
        bad_before = self._reader.bad
        try:
            counts = self._ask(self._serial)
        except _BROKEN as error:
            raise LostSensorError(
                expected(self.name, "a working port", error, "Was it unplugged?")
            ) from error
        missing = [i for i in self._ids if i not in counts]
        if missing:
            self._count_failure(missing, self._reader.bad - bad_before)
            return []
        self._failed_in_a_row, self._samples = 0, self._samples + 1
        angles = np.array([counts[i] for i in self._ids]) * (2 * np.pi / COUNTS_PER_TURN)
        return [Stamped(now_ns(), angles)]

    def close(self) -> None:
        """Close the port."""
        port, self._serial = self._serial, None
        if port is not None:
            with contextlib.suppress(*_BROKEN):  # gone already; its descriptor is released anyway
                port.close()

    def _ask(self, port: serial.Serial) -> dict[int, int]:
        """Return id → position in counts of the motors that answered in time."""
        time.sleep(REST_S)
        self._reader.forget()
        port.reset_input_buffer()  # late answers belong to the last question
        port.write(sync_read(self._ids))
        counts: dict[int, int] = {}
        deadline = time.monotonic() + ANSWER_S
        while len(counts) < len(self._ids) and time.monotonic() < deadline:
            for status in self._reader.feed(port.read(max(1, port.in_waiting))):
                if status.device_id in self._ids and len(status.parameters) == POSITION_BYTES:
                    counts[status.device_id] = struct.unpack("<i", status.parameters)[0]
        return counts

    def _count_failure(self, missing: list[int], broken: int) -> None:
        self._lost += 1
        self._failed_in_a_row += 1
        if self._failed_in_a_row < FAILED_IN_A_ROW:
            return
        if len(missing) == len(self._ids) and not broken:
            do = "Is it powered, and is the baud rate right?"
            raise LostSensorError(expected(self.name, "answers", "none", do))
        do = "Check the chain's cables from the first missing motor on."
        came = f"none whole from {missing}, {broken} broken packets"
        raise ProtocolError(expected(self.name, f"answers of motors {list(self._ids)}", came, do))
