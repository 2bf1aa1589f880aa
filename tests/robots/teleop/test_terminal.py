"""Keys of a terminal: pulses of speed, hand guiding's width, and a terminal that goes away."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import uniforce_robots.teleop as ours
from uniforce_robots.franka.arm import HAND_GUIDED
from uniforce_robots.teleop.base import FEEDBACK_AGE_S
from uniforce_robots.teleop.keyboard import KEYS, PULSE_S
from uniforce_vtla.errors import TeleoperatorError
from uniforce_vtla.keys import AXES

Type = Callable[[bytes], None]


@pytest.fixture
def keyboard(connected: Callable[[str], Any], measured: np.ndarray) -> Any:
    device = connected("uniforce_keyboard")
    device.start_from(measured)
    return device


@pytest.mark.parametrize("key", sorted(KEYS))
def test_each_key_moves_its_axis(keyboard: Any, terminal: Type, until: Callable[..., Any], key: str) -> None:
    axis, direction = KEYS[key]
    start = np.array([0.5, 0.0, 0.2, 0.0, 0.04])  # inside the box on every axis
    keyboard.start_from(start)
    terminal(key.encode())
    moved = until(lambda: np.array(list(keyboard.get_action().values())), lambda now: now[axis] != start[axis])
    assert np.sign(moved[axis] - start[axis]) == direction
    assert np.array_equal(np.delete(moved, axis), np.delete(start, axis))


def test_one_press_is_one_short_pulse(keyboard: Any, terminal: Type, until: Callable[..., Any]) -> None:
    terminal(b"w")
    until(lambda: keyboard.keys.rates(), lambda rates: rates.any())
    time.sleep(2 * PULSE_S)
    assert not keyboard.keys.rates().any()


def test_opposite_keys_cancel(keyboard: Any) -> None:
    for key in "wsW":
        keyboard.keys.press(key)
    assert not keyboard.keys.rates().any()


def test_keys_of_a_recorder_are_kept_for_it(keyboard: Any, terminal: Type, until: Callable[..., Any]) -> None:
    terminal(b"nwr")
    assert until(keyboard.keys.take_others, bool) in (["n"], ["n", "r"])


def test_a_press_before_the_start_moves_nothing(keyboard: Any, measured: np.ndarray) -> None:
    keyboard.keys.press("w")
    keyboard.start_from(measured)
    assert not keyboard.keys.rates().any()


def test_a_terminal_that_hangs_up_is_a_fault(keyboard: Any, terminal: Type, fault_of: Callable) -> None:
    terminal(b"")
    assert fault_of(keyboard.get_action) == "connection"


def test_without_a_terminal_there_is_no_keyboard(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "piped").open("w+") as piped:
        monkeypatch.setattr("sys.stdin", piped)
        device = ours.UniforceKeyboard(ours.UniforceKeyboardConfig(calibration_dir=tmp_path))
        with pytest.raises(TeleoperatorError, match="terminal"):
            device.connect()
    assert not device.is_connected


@pytest.fixture
def guide(connected: Callable[[str], Any], measured: np.ndarray) -> Any:
    device = connected("uniforce_hand_guide")
    device.start_from(measured)
    return device


def action_at(device: Any, axes: np.ndarray) -> np.ndarray:
    device.send_feedback(dict(zip(AXES, axes.tolist(), strict=True)))
    return np.array(list(device.get_action().values()))


def test_the_measured_pose_is_the_action(guide: Any, measured: np.ndarray) -> None:
    led = measured + np.array([0.03, -0.02, 0.01, 0.2, 0.0])
    assert np.array_equal(action_at(guide, led)[:4], led[:4])


def test_the_width_is_commanded_by_keys(guide: Any, measured: np.ndarray) -> None:
    own = action_at(guide, measured - np.array([0, 0, 0, 0, 0.01]))
    assert own[4] == measured[4], "the fingers' own motion is no command"
    guide.keys.press("p")
    time.sleep(0.02)
    assert action_at(guide, measured)[4] < measured[4]


def test_an_old_pose_is_not_followed(guide: Any, measured: np.ndarray) -> None:
    action_at(guide, measured)
    later = time.monotonic() + 2 * FEEDBACK_AGE_S
    guide.clock = lambda: later
    with pytest.raises(TeleoperatorError) as error:
        guide.get_action()
    assert error.value.fault == "stale"


def test_a_soft_arm_led_by_hand_goes_where_it_is_led(guide: Any) -> None:
    """A spring to the target, damping, and a hand that pushes 4 N: the arm must follow, and stay when it lets go."""
    assert guide.wants_gains == HAND_GUIDED
    stiffness, damping, period = HAND_GUIDED.stiffness_N_m[0], 60.0, 1 / 30
    position, target = 0.45, 0.45
    for step in range(60):
        push_N = 4.0 if step < 30 else 0.0
        position += (push_N + stiffness * (target - position)) / damping * period
        target = action_at(guide, np.array([position, 0, 0.2, 0, 0.08]))[0]
    assert position > 0.50 and abs(target - position) < 1e-9
