"""Gamepad and phone: thin adapters onto LeRobot's, whose libraries are not installed here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.teleoperators.gamepad import GamepadTeleop
from teleop_fakes import FakePad, Paced

import uniforce_robots.teleop as ours
from uniforce_vtla.errors import TeleoperatorError


def test_the_stick_is_speed(connected: Callable[[str], Any], measured: np.ndarray) -> None:
    pad = Paced(connected("uniforce_gamepad"), measured)
    pad.inner.device.said |= {"delta_x": 1.0, "delta_y": -0.5, "gripper": 0}
    first, second = pad.next(), pad.next()
    assert np.allclose((second - first)[:3] / 0.1 * 30, [1.0, -0.5, 0.0])
    assert second[4] < first[4] and second[3] == measured[3]


def test_lerobots_pad_says_what_we_read() -> None:
    """The adapter's keys are LeRobot's: a renamed one must not pass unnoticed."""
    pad = GamepadTeleop.__new__(GamepadTeleop)
    pad.config = type("Config", (), {"use_gripper": True})
    assert set(pad.action_features["names"]) == set(FakePad().said)


def test_without_a_pad_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pad = ours.UniforceGamepad(ours.UniforceGamepadConfig(calibration_dir=tmp_path))
    monkeypatch.setattr(pad, "make_device", lambda: FakePad(running=False))
    with pytest.raises(TeleoperatorError, match="Plug it in") as error:
        pad.connect()
    assert error.value.fault == "connection"


@pytest.mark.parametrize(
    ("kind", "extra", "library"),
    [(ours.UniforceGamepad, "gamepad", "pygame"), (ours.UniforcePhone, "phone", "hebi")],
)
def test_a_missing_library_is_named_with_its_extra(
    kind: Any, extra: str, library: str, tmp_path: Path
) -> None:
    import importlib.util

    if importlib.util.find_spec(library):
        pytest.skip(f"{library} is installed here")
    device = kind(kind.config_class(calibration_dir=tmp_path))
    with pytest.raises(TeleoperatorError, match=rf"lerobot\[{extra}\]") as error:
        device.connect()
    assert error.value.fault == "missing"


@pytest.fixture
def phone(connected: Callable[[str], Any], measured: np.ndarray) -> Any:
    return Paced(connected("uniforce_phone"), measured)


def run(phone: Any, ticks: int, moves: np.ndarray | float = 0.0) -> np.ndarray:
    """Move the phone a little per tick (never still, as a hand) and return the last target."""
    for tick in range(ticks):
        phone.inner.device.position = phone.inner.device.position + moves + 1e-9 * (tick % 2)
        target = phone.next()
    return target


def test_the_phone_moves_the_target_only_while_held(phone: Any, measured: np.ndarray) -> None:
    assert np.allclose(run(phone, 20, np.array([0.01, 0, 0])), measured, atol=1e-6)
    phone.inner.device.enabled = True
    held = run(phone, 60, np.array([0.001, 0, 0]))
    assert held[1] == pytest.approx(
        measured[1] + 0.06, abs=0.005
    )  # LeRobot's map: the phone's x is the robot's y
    phone.inner.device.enabled = False
    assert np.allclose(run(phone, 30, np.array([0.01, 0, 0])), held, atol=1e-6)


def test_no_jump_when_the_button_is_pressed_far_away(phone: Any, measured: np.ndarray) -> None:
    phone.inner.device.position, phone.inner.device.turn_rad = np.array([3.0, -2.0, 1.0]), 1.0
    phone.inner.device.enabled = True
    assert np.allclose(run(phone, 10), measured, atol=1e-6)


def test_the_slider_moves_the_fingers(phone: Any, measured: np.ndarray) -> None:
    phone.inner.device.a3 = -1.0
    assert run(phone, 30)[4] == pytest.approx(measured[4] - 0.06, abs=0.005)


@pytest.mark.parametrize("how", ["no pose", "frozen"])
def test_a_lost_or_frozen_phone_is_stale(phone: Any, how: str) -> None:
    phone.inner.device.enabled = True
    run(phone, 3)
    phone.inner.device.has_pose = how == "frozen"
    with pytest.raises(TeleoperatorError) as error:
        for _ in range(40):
            phone.next()
    assert error.value.fault == "stale"


def test_a_phone_that_fails_inside_its_library_is_lost(phone: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> dict:
        raise TypeError("'NoneType' object is not subscriptable")

    monkeypatch.setattr(phone.inner.device, "get_action", gone)
    with pytest.raises(TeleoperatorError) as error:
        phone.next()
    assert error.value.fault == "connection"
