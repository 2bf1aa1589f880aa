"""Stand-ins as processes: ready lines, help, control, and clients that aren't our own drivers."""

import numpy as np
import pytest
import serial

from uniforce_robots.standins.process import StandIn
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.errors import SensorError

NAMES = ("slcan", "standins.xela", "mjpeg")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_each_is_ready_obeys_and_ends(name: str):
    with StandIn(name, "press_s=0", "rest_s=0.5") as stand_in:
        assert stand_in.address.startswith(("/tmp/", "127.0.0.1:", "http://127.0.0.1:")), "this machine only"
        stand_in.inject("stall")
        assert stand_in.stats()["sent"] == 0
        process = stand_in.process
    assert process.poll() is not None
    with pytest.raises((SensorError, ValueError)):
        stand_in.inject("stall")


@pytest.mark.slow
def test_an_unknown_fault_is_refused():
    with pytest.raises(SensorError, match="ready"):
        StandIn("slcan", "fault=gremlins")


@pytest.mark.slow
def test_slcan_speaks_to_plain_serial_lines():
    """Written from the adapter's manual, without our driver's parser."""
    with (
        StandIn("slcan", "rate_hz=50", "controller=4") as stand_in,
        serial.Serial(stand_in.address, 3_000_000, timeout=20) as port,
    ):
        answers = {}
        for command in (b"C", b"V", b"S8", b"O"):
            port.write(command + b"\r")
            answers[command] = port.read_until(b"\x07" if command == b"C" else b"\r")
        lines = [port.read_until(b"\r") for _ in range(32)]
    assert answers == {b"C": b"\x07", b"V": b"V1013\r", b"S8": b"\r", b"O": b"\r"}
    first = taxel_cycle(Scene(), 50)[:2].reshape(-1, 3)
    for line, counts in zip(lines, first, strict=True):
        assert len(line) == 22 and line[4:7] == b"893"
        assert np.array_equal([int(line[i : i + 4], 16) for i in (7, 11, 15)], counts)
    assert [line[1:4] for line in lines[:5]] == [b"004", b"014", b"024", b"034", b"104"]
