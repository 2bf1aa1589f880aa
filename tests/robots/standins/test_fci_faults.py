"""When a fault begins and ends, in the robot's own milliseconds, and what is said of the arm after it."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from fci_client import RawArm, pull_to, wait_until

from benchmarks.trust.hostile_arm import DOCUMENTED, FAULTS, INVENTED, NONE, REPORTED, HostileArm, HostileStandIn
from uniforce_robots.standins.fci.link import Journal
from uniforce_robots.standins.fci.protocol import ARM_VERSION


@pytest.fixture
def fci(address: str) -> Iterator[HostileStandIn]:
    with HostileStandIn(address) as standin:
        yield standin


def test_every_fault_says_in_one_line_what_it_does_and_where_it_comes_from() -> None:
    for name, fault in FAULTS.items():
        assert fault.source in (DOCUMENTED, REPORTED, INVENTED), name
        assert fault.does and "\n" not in fault.does, name


def test_an_arm_knows_when_it_moved_last(address: str) -> None:
    service = HostileArm(address, ARM_VERSION, Journal(None))
    for speed_rad_s, held_ms, moving_ms in ((0.0, 0, None), (0.1, None, 2), (1e-3, 3, 2)):  # the last one creeps
        service.arm.dq_rad_s = np.array([0.0, speed_rad_s, 0, 0, 0, 0, 0])
        service.arm.refresh()
        service.tick()
        shown = service.describe()
        assert (shown["held_since_ms"], shown["last_moving_ms"]) == (held_ms, moving_ms)
    service.link.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["earthquake", ["reflex"], None])
def test_an_unknown_fault_is_refused(fci: HostileStandIn, name: object) -> None:
    with pytest.raises(ValueError, match="Error"):
        fci.do("fault", name=name)
    assert fci.do("look")["fault"] == {"name": NONE, "last": NONE, "at_ms": None, "at_s": None}


@pytest.mark.slow
def test_a_second_fault_takes_the_place_of_the_first(fci: HostileStandIn) -> None:
    with RawArm(fci.address) as arm:
        fci.do("fault", name="nan_state")
        begun = fci.do("fault", name="nan_force")["fault"]["at_ms"]
        state = arm.state()
        while state.message_id <= begun:
            state = arm.state()
        assert np.isfinite(state["q"]).all() and np.isnan(state["O_F_ext_hat_K"]).all()
        assert fci.do("fault", name=NONE)["fault"]["name"] == NONE


@pytest.mark.slow
def test_it_is_known_how_long_after_a_fault_the_arm_came_to_rest(fci: HostileStandIn) -> None:
    with RawArm(fci.address) as arm:
        goal = arm.state()["O_T_EE"][12:15] + np.array([0, 0, -0.05])
        arm.start()
        arm.loop(pull_to(goal), 80)
        begun = fci.do("fault", name="user_stop")
        assert begun["arm"]["held_since_ms"] is None, "it was moving"
        at_ms = begun["fault"]["at_ms"]
        wait_until(lambda: fci.do("look")["arm"]["held_since_ms"] is not None, 60)
        look = fci.do("look")["arm"]
        assert 0 < look["last_moving_ms"] - at_ms < 100, "the brake takes 50 ms"
        assert look["held_since_ms"] == look["last_moving_ms"] + 1
        assert begun["fault"]["at_s"] < time.monotonic()
        assert not any(look["tau_Nm"]), "the brake takes the torque away"


@pytest.mark.slow
def test_no_fault_of_the_states_reaches_what_is_said_beside_them(fci: HostileStandIn) -> None:
    with RawArm(fci.address) as arm:
        arm.state()
        before = fci.do("look")["arm"]
        for name in ("nan_state", "inf_state", "pose_jump", "velocity_beyond_physics", "garbage_state"):
            shown = fci.do("fault", name=name)["arm"]
            for key in ("q_rad", "position_m", "speed_rad_s", "errors"):
                assert shown[key] == before[key]
