"""Stand-ins as processes: ready lines, help, control, and clients that aren't our own drivers."""

import numpy as np
import pytest
import serial

from uniforce_robots.standins.process import StandIn
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.errors import SensorError

NAMES = ("slcan", "standins.xela", "mjpeg")


@pytest.mark.parametrize("name", NAMES)
def test_each_is_ready_obeys_and_ends(name):
    with StandIn(name, "press_s=0", "rest_s=0.5") as stand_in:
        assert stand_in.address.startswith(("/tmp/", "127.0.0.1:", "http://127.0.0.1:")), (
            "this machine only"
        )
        stand_in.inject("stall")
        assert stand_in.stats()["sent"] == 0
        process = stand_in.process
    assert process.poll() is not None
    with pytest.raises((SensorError, ValueError)):
        stand_in.inject("stall")


def test_an_unknown_fault_is_refused():
    with pytest.raises(SensorError, match="ready"):
        StandIn("slcan", "fault=gremlins")


def test_slcan_speaks_to_plain_serial_lines():
    """Written from the adapter's manual, without our driver's parser."""
    with (
        StandIn("slcan", "rate_hz=50", "controller=4") as stand_in,
        serial.Serial(stand_in.address, 3_000_000, timeout=20) as port,
    ):
        for command, answer in {b"C": b"\x07", b"V": b"V1013\r", b"S8": b"\r", b"O": b"\r"}.items():
            port.write(command + b"\r")
            assert port.read_until(answer[-1:]) == answer
        lines = [port.read_until(b"\r") for _ in range(5)]
    counts = [[int(line[i : i + 4], 16) for i in (7, 11, 15)] for line in lines]
    assert np.array_equal(counts, taxel_cycle(Scene(), 50)[:2].reshape(-1, 3)[:5])
    assert [line[1:7] for line in lines] == [b"004893", b"014893", b"024893", b"034893", b"104893"]
