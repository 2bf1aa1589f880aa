from functools import partial

import pytest
from fci_client import wait_until
from hand_fakes import FakeHand
from robot_fakes import FakeArm

from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka import robot as robot_module
from uniforce_robots.franka.limits import HARD_LIMITS, Range, StreamSettings


@pytest.fixture
def eventually():
    return partial(wait_until, timeout_s=30.0)


@pytest.fixture
def arm():
    return FakeArm()


@pytest.fixture
def hand():
    return FakeHand()


@pytest.fixture
def patient(monkeypatch):
    """Ages no robot may have, for a test machine that stalls longer than a robot's computer may."""
    for name in ("stale_s", "state_age_s"):
        monkeypatch.setitem(HARD_LIMITS["StreamSettings"], name, Range(0, 100))
    monkeypatch.setitem(HARD_LIMITS["HandSettings"], "reading_age_s", Range(0, 100))
    return StreamSettings(stale_s=30.0, state_age_s=30.0)


@pytest.fixture
def make_robot(arm, hand, tmp_path, monkeypatch, patient):
    """Return a function: further settings → a robot on the fake arm and hand."""
    monkeypatch.setattr(robot_module, "make_backend", lambda config: (arm, hand))
    own = {"id": "test", "calibration_dir": tmp_path, "stream": patient}
    return lambda **settings: UniforceFranka(UniforceFrankaConfig(**own, **settings))
