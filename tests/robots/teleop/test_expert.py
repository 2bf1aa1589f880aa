"""The scripted expert in its scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uniforce_robots.teleop as ours
from uniforce_vtla.errors import TeleoperatorError


def test_the_expert_outside_the_simulation_says_so(tmp_path: Path) -> None:
    expert = ours.UniforceExpert(ours.UniforceExpertConfig(calibration_dir=tmp_path))
    with pytest.raises(TeleoperatorError, match="simulated scene") as error:
        expert.connect()
    assert error.value.fault == "simulation_only" and not expert.is_connected


def test_the_expert_steers_its_scene_as_without_the_teleoperator(connected: Callable[[str], Any]) -> None:
    from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert

    alone, plain = WipeEnv("easy"), WipeExpert()
    alone.start(0)
    plain.reset(alone)
    expert = connected("uniforce_expert")
    env = expert.env
    expert.start_from(env.state)
    for _ in range(5):
        action = np.array(list(expert.get_action().values()), np.float32)
        assert np.array_equal(action, plain.act(alone))
        env.advance(action)
        alone.advance(action)
