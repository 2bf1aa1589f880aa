"""Each teleoperator, connected to a stand-in or a fake, so that one contract test serves all."""

import os
import tempfile
import time
from contextlib import ExitStack

import pytest

# LeRobot's base class makes a calibration folder below its cache as soon as a teleoperator is made
os.environ.setdefault("HF_LEROBOT_CALIBRATION", tempfile.mkdtemp(prefix="uniforce-calibration-"))

import teleop_fakes

from uniforce_vtla.errors import TeleoperatorError


@pytest.fixture
def connected(tmp_path, request, terminal):
    """Return a function: registered name → that teleoperator, connected until the end."""
    with ExitStack() as closing:

        def make(name):
            teleoperator = teleop_fakes.make(name, request, tmp_path)
            teleoperator.connect()
            closing.callback(teleoperator.disconnect)
            return teleoperator

        yield make


@pytest.fixture
def measured():
    """(5,) where the robot is: the GELLO stand-in's home posture, fingers open."""
    return teleop_fakes.home_axes()


@pytest.fixture
def started(connected, measured):
    """Return a function: registered name → that teleoperator, started where the robot is."""

    def start(name):
        device = connected(name)
        device.start_from(measured)
        return device

    return start


@pytest.fixture
def until():
    """Return a function that asks until it likes the answer, and returns that."""

    def wait(ask, says, timeout_s=20.0):
        deadline = time.monotonic() + timeout_s
        while not says(answer := ask()):
            assert time.monotonic() < deadline, answer
            time.sleep(0.005)
        return answer

    return wait


def fault_or_none(ask):
    """Return the fault asking meets, "" where it meets none."""
    try:
        ask()
    except TeleoperatorError as error:
        return error.fault
    return ""


@pytest.fixture
def fault_of(until):
    """Return a function that asks until a TeleoperatorError comes, and says its fault."""
    return lambda ask: until(lambda: fault_or_none(ask), bool)


@pytest.fixture
def starts(until, measured):
    return lambda device: until(
        lambda: fault_or_none(lambda: device.start_from(measured)), lambda f: not f
    )
