"""LeRobot's gamepad and phone without their libraries, and how each teleoperator is made for a test."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.rotation import Rotation

import uniforce_robots.teleop as ours
from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad
from uniforce_robots.teleop.gello import tool_axes


def home_axes() -> np.ndarray:
    """(5,) of the arm's home posture with open fingers."""
    return np.array([*tool_axes(HOME_q_rad, float(HAND_TO_FLANGE[2, 3])), 0.08])


class Paced:
    """A started teleoperator whose clock makes 30 ticks a second, one per ``next``."""

    def __init__(self, inner: Any, measured: np.ndarray) -> None:
        self.inner, self._now = inner, 0.0
        inner.clock = lambda: self._now
        inner.start_from(measured)

    def next(self) -> np.ndarray:
        """(5,) the next action."""
        self._now += 1 / 30
        return np.array(list(self.inner.get_action().values()))


class FakePad:
    """What LeRobot's GamepadTeleop looks like to its user."""

    def __init__(self, running: bool = True) -> None:
        self.gamepad = SimpleNamespace(running=running)
        self.is_connected = False
        self.said = {"delta_x": 0.0, "delta_y": 0.0, "delta_z": 0.0, "gripper": 1}

    def connect(self) -> None:
        self.is_connected = True

    def disconnect(self) -> None:
        self.is_connected = False

    def get_action(self) -> dict[str, Any]:
        return dict(self.said)


class FakePhone(FakePad):
    """What LeRobot's Phone looks like; held still unless asked."""

    def __init__(self) -> None:
        super().__init__()
        self.position, self.turn_rad = np.zeros(3), 0.0
        self.enabled, self.has_pose, self.a3 = False, True, 0.0

    def get_action(self) -> dict[str, Any]:
        if not self.has_pose:
            return {}
        return {
            "phone.pos": self.position.copy(),
            "phone.rot": Rotation.from_rotvec(np.array([0, 0, self.turn_rad])),
            "phone.raw_inputs": {"a3": self.a3},
            "phone.enabled": self.enabled,
        }


class Maker:
    """Makes a teleoperator from its config; ``standin`` fills the named setting, ``fake`` stands in for LeRobot's."""

    def __init__(self, config: Any, setting: str = "", standin: str = "", fake: Any = None) -> None:
        self.config, self.setting, self.standin, self.fake = config, setting, standin, fake

    def __call__(self, request: pytest.FixtureRequest, folder: Path, patch: pytest.MonkeyPatch) -> Any:
        where = {self.setting: request.getfixturevalue(self.standin).address} if self.standin else {}
        made = make_teleoperator_from_config(self.config(calibration_dir=folder, **where))
        if self.fake:
            patch.setattr(made, "make_device", self.fake)
        return made


def make_expert(request: pytest.FixtureRequest, folder: Path, patch: pytest.MonkeyPatch) -> Any:
    from lerobot_env_uniforce_wiping import WipeEnv

    expert = ours.UniforceExpert(ours.UniforceExpertConfig(calibration_dir=folder))
    env = WipeEnv("easy")
    env.start(0)
    expert.attach(env)
    return expert


MAKERS = {
    "uniforce_keyboard": Maker(ours.UniforceKeyboardConfig),
    "uniforce_hand_guide": Maker(ours.UniforceHandGuideConfig),
    "uniforce_spacemouse": Maker(ours.UniforceSpaceMouseConfig, "device", "spacemouse"),
    "uniforce_gello": Maker(ours.UniforceGelloConfig, "port", "gello"),
    "uniforce_gamepad": Maker(ours.UniforceGamepadConfig, fake=FakePad),
    "uniforce_phone": Maker(ours.UniforcePhoneConfig, fake=FakePhone),
    "uniforce_expert": make_expert,
}
