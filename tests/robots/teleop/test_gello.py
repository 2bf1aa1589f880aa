"""GELLO on a pseudo-terminal that speaks Dynamixel 2.0."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from teleop_fakes import Paced

import uniforce_robots.teleop as ours
from uniforce_robots.fr3 import HOME_q_rad
from uniforce_robots.standins.process import StandIn
from uniforce_robots.teleop.gello import LIMITS, offsets
from uniforce_vtla.errors import ContractError, TeleoperatorError


@pytest.fixture
def leader(connected: Callable[[str], Any], measured: np.ndarray) -> Any:
    device = connected("uniforce_gello")
    device.start_from(measured)
    return device


def test_joints_become_the_tools_pose(leader: Any) -> None:
    assert np.abs(leader._joints_and_trigger()[0] - HOME_q_rad).max() < 0.03  # it swings by 0.02
    # the Franka's home posture in Franka's own documents: the hand 0.307 m in front of the base, pointing down
    assert abs(leader._pose()[0] - 0.307) < 0.03
    assert leader._pose()[4] == pytest.approx(0.08)


def test_the_target_follows_without_a_jump(leader: Any, measured: np.ndarray) -> None:
    paced, before = Paced(leader, measured), measured
    for _ in range(60):
        now = paced.next()
        assert np.all(np.abs(now - before) <= np.array(leader.config.limits.speed) / 30 + 1e-9)
        before = now
    assert np.abs(now[:3] - measured[:3]).max() < 0.05


def test_it_refuses_to_start_far_from_the_robot(leader: Any, measured: np.ndarray) -> None:
    with pytest.raises(TeleoperatorError, match="Bring them together") as error:
        leader.start_from(measured + np.array([0.2, 0, 0, 0, 0]))
    assert error.value.fault == "far"
    with pytest.raises(TeleoperatorError, match="started"):
        leader.get_action()


@pytest.mark.parametrize("fault", ["split", "alert"])
def test_what_is_harmless_is_lived_with(leader: Any, gello: StandIn, fault: str) -> None:
    """Answers in small pieces are whole; a motor's alert bit (overheating) does not spoil its position."""
    gello.inject(fault)
    before = leader.device.counts.samples
    for _ in range(20):
        leader.get_action()
        leader.device.wait_newer(leader.device.newest(1e3).index, 2000.0)
    assert leader.device.counts.samples >= before + 20


def test_a_mute_chain_is_no_connection(gello: StandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    gello.inject("mute")
    monkeypatch.setattr("uniforce_robots.teleop.gello.LIMITS", replace(LIMITS, first_ms=200.0))
    device = ours.UniforceGello(ours.UniforceGelloConfig(port=gello.address, calibration_dir=tmp_path))
    with pytest.raises(TeleoperatorError):
        device.connect()
    assert not device.is_connected


def test_a_missing_library_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    device = ours.UniforceGello(ours.UniforceGelloConfig(port="x", calibration_dir=tmp_path))
    with pytest.raises(TeleoperatorError, match=r"lerobot\[dynamixel\]") as error:
        device.connect()
    assert error.value.fault == "missing"


def test_a_chain_needs_seven_joints_and_a_trigger(tmp_path: Path) -> None:
    with pytest.raises(ContractError, match="8, 7, 7"):
        ours.UniforceGello(ours.UniforceGelloConfig(ids=(1, 2, 3), calibration_dir=tmp_path))


@given(
    arrays(np.int64, 7, elements=st.integers(-8, 8)),
    arrays(np.int64, 7, elements=st.sampled_from([-1, 1])),
    arrays(np.float64, 7, elements=st.floats(-0.3, 0.3)),
)
def test_offsets_come_out_of_an_inexactly_held_posture(quarters: np.ndarray, signs: np.ndarray, slack: np.ndarray):
    mounted = quarters * np.pi / 2
    motors = mounted + signs * (HOME_q_rad + slack)
    assert np.allclose(offsets(motors, signs, HOME_q_rad), mounted)
