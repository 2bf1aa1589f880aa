"""When a fault begins and ends, in the robot's own milliseconds, and the arm's state after it."""

import numpy as np
import pytest

from benchmarks.trust.hostile_arm import NONE, HostileArm, HostileStandIn
from uniforce_robots.standins.fci.link import Journal
from uniforce_robots.standins.fci.protocol import ARM_VERSION


@pytest.fixture
def fci(address):
    with HostileStandIn(address) as standin:
        yield standin


def test_an_arm_knows_when_it_moved_last(address):
    service = HostileArm(address, ARM_VERSION, Journal(None))
    # the last one creeps
    for speed_rad_s, held_ms, moving_ms in ((0.0, 0, None), (0.1, None, 2), (1e-3, 3, 2)):
        service.arm.dq_rad_s = np.array([0.0, speed_rad_s, 0, 0, 0, 0, 0])
        service.arm.refresh()
        service.tick()
        shown = service.describe()
        assert (shown["held_since_ms"], shown["last_moving_ms"]) == (held_ms, moving_ms)
    service.link.listener.close()
    service.link.udp.close()


@pytest.mark.parametrize("name", ["earthquake", ["reflex"], None])
def test_an_unknown_fault_is_refused(fci, name):
    with pytest.raises(ValueError, match="Error"):
        fci.do("fault", name=name)
    assert fci.do("look")["fault"] == {"name": NONE, "last": NONE, "at_ms": None, "at_s": None}
