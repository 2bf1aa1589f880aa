"""How each teleoperator is made for a test."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.teleoperators import make_teleoperator_from_config

import uniforce_robots.teleop as ours
from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad
from uniforce_robots.teleop.gello import tool_axes


def home_axes() -> np.ndarray:
    return np.array([*tool_axes(HOME_q_rad, float(HAND_TO_FLANGE[2, 3])), 0.08])


class Paced:
    """A started teleoperator whose clock makes 30 ticks a second, one per ``next``."""

    def __init__(self, inner: Any, measured: np.ndarray) -> None:
        self.inner, self._now = inner, 0.0
        inner.clock = lambda: self._now
        inner.start_from(measured)

    def next(self) -> np.ndarray:
        self._now += 1 / 30
        return np.array(list(self.inner.get_action().values()))


class Maker:
    """Makes a teleoperator from its config; ``standin`` fills the named setting."""

    def __init__(self, config: Any, setting: str = "", standin: str = "") -> None:
        self.config, self.setting, self.standin = config, setting, standin

    def __call__(self, request: pytest.FixtureRequest, folder: Path) -> Any:
        where = {self.setting: request.getfixturevalue(self.standin).address} if self.standin else {}
        return make_teleoperator_from_config(self.config(calibration_dir=folder, **where))


MAKERS = {
    "uniforce_keyboard": Maker(ours.UniforceKeyboardConfig),
    "uniforce_hand_guide": Maker(ours.UniforceHandGuideConfig),
    "uniforce_spacemouse": Maker(ours.UniforceSpaceMouseConfig, "device", "spacemouse"),
    "uniforce_gello": Maker(ours.UniforceGelloConfig, "port", "gello"),
}
