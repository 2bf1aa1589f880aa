from functools import partial

import pytest
from fci_client import wait_until
from robot_fakes import FakeArm

from uniforce_robots.franka.limits import HARD_LIMITS, Range, StreamSettings


@pytest.fixture
def eventually():
    return partial(wait_until, timeout_s=30.0)


@pytest.fixture
def arm():
    return FakeArm()


@pytest.fixture
def patient(monkeypatch):
    """Ages no robot may have, for a test machine that stalls longer than a robot's computer may."""
    for name in ("stale_s", "state_age_s"):
        monkeypatch.setitem(HARD_LIMITS["StreamSettings"], name, Range(0, 100))
    monkeypatch.setitem(HARD_LIMITS["HandSettings"], "reading_age_s", Range(0, 100))
    return StreamSettings(stale_s=30.0, state_age_s=30.0)
