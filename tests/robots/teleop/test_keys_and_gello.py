"""Keys of a terminal, hand guiding's width, GELLO on a pseudo-terminal with Dynamixel 2.0."""

import itertools
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from robot_fakes import refused
from teleop_fakes import next_axes

import uniforce_robots.teleop as ours
from uniforce_robots.fr3 import HOME_q_rad
from uniforce_robots.franka.arm import HAND_GUIDED
from uniforce_robots.franka.poses import by_axis
from uniforce_robots.teleop.base import FEEDBACK_AGE_S
from uniforce_robots.teleop.gello import LIMITS, offsets
from uniforce_robots.teleop.keyboard import KEYS, PULSE_S
from uniforce_vtla.errors import ContractError, TeleoperatorError


@pytest.fixture
def keyboard(started):
    return started("uniforce_keyboard")


@pytest.mark.parametrize("key", sorted(KEYS))
def test_each_key_moves_its_axis(keyboard, terminal, until, key):
    axis, direction = KEYS[key]
    start = np.array([0.5, 0.0, 0.2, 0.0, 0.04])  # inside the box on every axis
    keyboard.start_from(start)
    terminal(key.encode())
    moved = until(lambda: next_axes(keyboard), lambda now: now[axis] != start[axis])
    assert np.sign(moved[axis] - start[axis]) == direction
    assert np.array_equal(np.delete(moved, axis), np.delete(start, axis))


def test_one_press_is_one_short_pulse(keyboard, terminal, until):
    terminal(b"w")
    until(lambda: keyboard.keys.rates(), lambda rates: rates.any())
    time.sleep(2 * PULSE_S)
    assert not keyboard.keys.rates().any()


def test_opposite_keys_cancel(keyboard):
    for key in "wsW":
        keyboard.keys.press(key)
    assert not keyboard.keys.rates().any()


def test_keys_of_a_recorder_are_kept_for_it(keyboard, terminal, until):
    terminal(b"nwr")
    assert until(keyboard.keys.take_others, bool) in (["n"], ["n", "r"])


@pytest.mark.parametrize("key", ["o", "O"])
@pytest.mark.parametrize("name", ["uniforce_keyboard", "uniforce_hand_guide"])
def test_a_key_held_over_a_start_steers_once_it_was_let_go(name, key, connected):
    device = connected(name)
    now = [0.0]
    device.clock = lambda: now[0]
    start = np.full(5, 0.04)

    def held(ticks):
        for _ in range(ticks):
            device.keys.press(key)
            now[0] += 0.03
            width_m = action_at(device, start)[4]
        return width_m

    device.start_from(start)
    assert held(3) > 0.04
    for _ in range(2):  # however often it is started
        device.start_from(start)
        assert held(20) == 0.04
    now[0] += PULSE_S
    assert action_at(device, start)[4] == 0.04
    assert held(3) > 0.04


def test_a_text_neither_steers_nor_loses_letters(keyboard):
    keys = keyboard.keys
    keys.text_begins = "t"
    for key in ("w", "T", "W", "space", "esc"):
        keys.press(key)
    assert not keys.rates().any(), "and what was held before stops"
    assert keys.take_others() == ["t", "W", "space", "esc"]
    keys.press("s")
    assert keys.rates()[0] == -1


def test_a_terminal_that_hangs_up_is_a_fault(keyboard, terminal, fault_of):
    terminal(b"")
    assert fault_of(keyboard.get_action) == "connection"


def test_without_a_terminal_there_is_no_keyboard(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    device = ours.UniforceKeyboard(ours.UniforceKeyboardConfig(calibration_dir=tmp_path))
    with pytest.raises(TeleoperatorError, match="terminal"):
        device.connect()
    assert not device.is_connected


@pytest.fixture
def guide(started):
    return started("uniforce_hand_guide")


def action_at(device, axes):
    device.send_feedback(by_axis(axes))
    return next_axes(device)


def test_the_measured_pose_is_the_action(guide, measured):
    led = measured + np.array([0.03, -0.02, 0.01, 0.2, 0.0])
    assert np.array_equal(action_at(guide, led)[:4], led[:4]), "no spring pulls it back"
    assert guide.wants_gains == HAND_GUIDED


def test_the_width_is_commanded_by_keys(guide, measured):
    own = action_at(guide, measured - np.array([0, 0, 0, 0, 0.01]))
    assert own[4] == measured[4], "the fingers' own motion is no command"
    guide.keys.press("p")
    time.sleep(0.02)
    assert action_at(guide, measured)[4] < measured[4]


def test_an_old_pose_is_not_followed(guide, measured):
    action_at(guide, measured)
    later = time.monotonic() + 2 * FEEDBACK_AGE_S
    guide.clock = lambda: later
    with refused("stale", TeleoperatorError):
        guide.get_action()


@pytest.fixture
def leader(started):
    return started("uniforce_gello")


def test_joints_become_the_tools_pose(leader):
    assert np.abs(leader._joints_and_trigger()[0] - HOME_q_rad).max() < 0.03  # it swings by 0.02
    # the Franka's home posture in its documents: the hand 0.307 m in front of the base
    assert leader._pose()[[0, 4]] == pytest.approx([0.307, 0.08], abs=0.03)
    assert leader._pose()[4] == pytest.approx(0.08)


def test_it_refuses_to_start_far_from_the_robot(leader, measured):
    with refused("far", TeleoperatorError, "Bring them together"):
        leader.start_from(measured + np.array([0.2, 0, 0, 0, 0]))
    with pytest.raises(TeleoperatorError, match="started"):
        leader.get_action()


def test_what_is_left_between_them_closes_once_it_is_moved(leader, measured, monkeypatch):
    pose = measured + np.array([0.02, 0, 0, 0, 0])
    monkeypatch.setattr(leader, "_pose", lambda: pose)
    ticks = itertools.count()
    leader.clock = lambda: next(ticks) / 30
    leader.start_from(measured)
    assert all(np.array_equal(next_axes(leader), measured) for _ in range(30)), "nobody moved it"
    pose = pose + np.array([0, 0.02, 0, 0, 0])
    assert np.all(next_axes(leader)[:2] > measured[:2])
    leader.start_from(measured)
    assert np.array_equal(next_axes(leader), measured)


@pytest.mark.parametrize("fault", ["split", "alert"])
def test_what_is_harmless_is_lived_with(leader, gello, fault):
    """Answers in small pieces are whole; a motor's alert bit doesn't spoil its position."""
    gello.inject(fault)
    before = leader.device.counts.samples
    for _ in range(20):
        leader.get_action()
        leader.device.wait_newer(leader.device.newest(1e3).index, 2000.0)
    assert leader.device.counts.samples >= before + 20


def test_a_mute_chain_is_no_connection(gello, tmp_path, monkeypatch):
    gello.inject("mute")
    monkeypatch.setattr("uniforce_robots.teleop.gello.LIMITS", replace(LIMITS, first_ms=200.0))
    device = ours.UniforceGello(
        ours.UniforceGelloConfig(port=gello.address, calibration_dir=tmp_path)
    )
    with pytest.raises(TeleoperatorError):
        device.connect()
    assert not device.is_connected


def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    device = ours.UniforceGello(ours.UniforceGelloConfig(port="x", calibration_dir=tmp_path))
    with refused("missing", TeleoperatorError, r"lerobot\[dynamixel\]"):
        device.connect()


def test_a_chain_needs_seven_joints_and_a_trigger(tmp_path):
    with pytest.raises(ContractError, match="8, 7, 7"):
        ours.UniforceGello(ours.UniforceGelloConfig(ids=(1, 2, 3), calibration_dir=tmp_path))


@given(
    arrays(np.int64, 7, elements=st.integers(-8, 8)),
    arrays(np.int64, 7, elements=st.sampled_from([-1, 1])),
    arrays(np.float64, 7, elements=st.floats(-0.3, 0.3)),
)
def test_offsets_come_out_of_an_inexactly_held_posture(quarters, signs, slack):
    mounted = quarters * np.pi / 2
    motors = mounted + signs * (HOME_q_rad + slack)
    assert np.allclose(offsets(motors, signs, HOME_q_rad), mounted)


@pytest.mark.thorough
def test_without_its_sdk_everything_else_is_there():
    absent = "import sys; sys.modules['dynamixel_sdk'] = None; "
    absent += "import uniforce_robots.teleop, lerobot_policy_pi05_uniforce"
    subprocess.run([sys.executable, "-c", absent], check=True)
