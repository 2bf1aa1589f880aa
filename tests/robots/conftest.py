"""Shared stand-ins of sensors and teleoperators: a process each, whole for every test."""

import itertools
import os
import sys
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import pytest

from uniforce_robots.standins.fci.process import StandIn as ArmStandIn
from uniforce_robots.standins.process import StandIn

# importlib mode gives test folders no package: their fakes are found here
sys.path[:0] = [
    str(Path(__file__).parent / name) for name in ("franka", "recorder", "sensors", "teleop")
]
RATE_HZ = 100.0  # enough for faults; the rate test starts its own at 500
# name → how errors call the sensor, the stand-in, and options
STANDINS = {
    "slcan": ("uskin", "slcan", f"rate_hz={RATE_HZ}"),
    "xela": ("uskin", "standins.xela", f"rate_hz={RATE_HZ}"),
    "mjpeg": ("tactip on the right finger", "mjpeg", "sensor=tactip", "rest_s=2", "press_s=1"),
    "gello": ("gello", "standins.gello", "swing_rad=0.02"),
    "spacemouse": ("spacemouse", "standins.spacemouse"),
}


@pytest.fixture(scope="session")
def stand_ins():
    """Return a function: name → that stand-in, started once."""
    with ExitStack() as closing:

        @cache
        def start(name):
            sensor, *program = STANDINS[name]
            stand_in = closing.enter_context(StandIn(*program))
            stand_in.sensor = sensor
            return stand_in

        yield start


def _whole(name):
    @pytest.fixture(name=name)
    def whole(stand_ins):
        stand_in = stand_ins(name)
        stand_in.inject("none")
        return stand_in

    return whole


globals().update({name: _whole(name) for name in STANDINS})

_numbers = itertools.count(2)


@pytest.fixture
def address():
    """A loopback address of its own: the ports are fixed, and tests may run side by side."""
    return f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250}.{next(_numbers) % 250}"


@pytest.fixture
def fci(address, tmp_path):
    with ArmStandIn(address, log=tmp_path / "wire.jsonl") as standin:
        yield standin


@pytest.fixture
def terminal(monkeypatch):
    master, slave = os.openpty()
    stdin = os.fdopen(slave, "r", closefd=False)
    monkeypatch.setattr("sys.stdin", stdin)
    open_ends = {master, slave}

    def type_keys(keys):
        if keys:
            os.write(master, keys)
        else:  # hang up
            open_ends.discard(master)
            os.close(master)

    yield type_keys
    for end in open_ends:
        os.close(end)
