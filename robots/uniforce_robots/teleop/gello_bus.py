"""A chain of Dynamixel motors on a serial port, asked for its positions over and over. Never run on hardware.

The packets are the maker's ``dynamixel-sdk``'s (extra ``gello``), as below LeRobot's own bus, whose layer above it says
in words only whether an answer was missing or broken.
"""

from __future__ import annotations

import contextlib
import struct
import termios
import time
from typing import TYPE_CHECKING

import numpy as np

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.samples import SourceCounts, Stamped, now_ns
from uniforce_vtla.errors import TeleoperatorError, expected

if TYPE_CHECKING:
    from dynamixel_sdk import GroupSyncRead, PortHandler

PRESENT_POSITION, POSITION_BYTES = 132, 4  # control table of the X series
COUNTS_PER_TURN = 4096
READ_TIMEOUT_S = 0.005  # the SDK asks without a pause otherwise, and takes a core while it waits
FAILED_IN_A_ROW = 5
REST_S = 0.002  # between two questions, so that a fast bus doesn't take a core: some 200 Hz
_BROKEN = (OSError, termios.error, TypeError)  # TypeError: pyserial's descriptor vanished while it read


class GelloBus:
    """A ``SampleSource`` of motor angles (N,) rad, in the order of ``ids``; a reading without all motors is dropped."""

    def __init__(self, port: str, ids: tuple[int, ...], baud: int) -> None:
        self.name = f"gello ({port})"
        self._port, self._ids, self._baud = port, tuple(ids), baud
        self._handler: PortHandler | None = None
        self._group: GroupSyncRead | None = None
        self._samples = self._lost = self._broken = self._failed_in_a_row = 0

    @property
    def counts(self) -> SourceCounts:
        """Whole readings, incomplete readings, broken packets."""
        return SourceCounts(self._samples, self._lost, self._broken)

    def open(self) -> None:
        """Open the port for ourselves.

        Raises:
            LostSensorError: no such port, or it is in use.
            TeleoperatorError: ``dynamixel-sdk`` is not installed.
        """
        try:
            from dynamixel_sdk import GroupSyncRead, PacketHandler, PortHandler
        except ImportError as error:
            do = 'Install it: pip install "lerobot[dynamixel]".'
            raise TeleoperatorError(expected(self.name, "dynamixel-sdk", error, do), "missing") from error
        self._failed_in_a_row = 0
        self._handler = handler = PortHandler(self._port)
        do = "Check the cable, permissions (group dialout), and that no other program holds it."
        try:
            if not handler.setBaudRate(self._baud):
                raise LostSensorError(expected(self.name, "a baud rate of the motors", self._baud, do))
            handler.ser.timeout, handler.ser.exclusive = READ_TIMEOUT_S, True
        except (*_BROKEN, ValueError) as error:
            self.close()
            raise LostSensorError(expected(self.name, "a serial port", error, do)) from error
        self._group = GroupSyncRead(handler, PacketHandler(2.0), PRESENT_POSITION, POSITION_BYTES)
        for motor in self._ids:
            self._group.addParam(motor)

    def read(self) -> list[Stamped]:
        """Ask once; return the angles if every motor answered.

        Raises:
            LostSensorError: the port is gone, or no motor answers.
            ProtocolError: broken packets, or some motor missing, several times in a row.
        """
        if self._handler is None or self._group is None:
            raise LostSensorError(expected(self.name, "an open port", "closed", "Call open()."))
        time.sleep(REST_S)
        answers = self._group.data_dict
        answers.update(dict.fromkeys(self._ids, b""))
        try:
            self._handler.ser.reset_input_buffer()  # late answers belong to the last question
            result = self._group.txRxPacket()
        except _BROKEN as error:
            do = "Was it unplugged?"
            raise LostSensorError(expected(self.name, "a working port", error, do)) from error
        if any(len(answers[motor]) != POSITION_BYTES for motor in self._ids):
            self._count_failure(result)
            return []
        self._failed_in_a_row, self._samples = 0, self._samples + 1
        counts = [struct.unpack("<i", bytes(answers[motor]))[0] for motor in self._ids]
        return [Stamped(now_ns(), np.array(counts) * (2 * np.pi / COUNTS_PER_TURN))]

    def close(self) -> None:
        """Close the port."""
        handler, self._handler = self._handler, None
        if handler is not None and handler.ser is not None:
            with contextlib.suppress(*_BROKEN):  # gone already; its descriptor is released anyway
                handler.closePort()

    def _count_failure(self, result: int) -> None:
        from dynamixel_sdk import COMM_RX_TIMEOUT

        assert self._group is not None
        missing = [motor for motor in self._ids if not self._group.data_dict[motor]]
        is_silent = result == COMM_RX_TIMEOUT
        self._lost, self._broken = self._lost + 1, self._broken + (not is_silent)
        self._failed_in_a_row += 1
        if self._failed_in_a_row < FAILED_IN_A_ROW:
            return
        if is_silent and len(missing) == len(self._ids):
            do = "Is it powered, and is the baud rate right?"
            raise LostSensorError(expected(self.name, "answers", "none", do))
        do = "Check the chain's cables from the first missing motor on."
        came = f"none whole from {missing}"
        raise ProtocolError(expected(self.name, f"answers of motors {list(self._ids)}", came, do))
