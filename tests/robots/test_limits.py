"""No number of the robot's settings goes beyond the hard limits, and every number has one."""

from __future__ import annotations

from dataclasses import fields

import pytest

from benchmarks.trust.bad_settings import NEEDS, bad_settings, try_all
from lerobot_robot_uniforce_franka.arm import HAND_GUIDED, ROLLOUT
from lerobot_robot_uniforce_franka.guards import GuardLimits
from lerobot_robot_uniforce_franka.limits import FORCE_N, HARD_LIMITS
from lerobot_robot_uniforce_franka.stream import StreamSettings
from uniforce_vtla.errors import ContractError


def test_every_bad_setting_is_refused_by_name() -> None:
    found = try_all()
    assert found["accepted"] == [] and found["tried"] >= 60


@pytest.mark.parametrize("kind", NEEDS, ids=lambda kind: kind.__name__)
def test_every_number_has_a_hard_limit(kind: type) -> None:
    numbers = {f.name for f in fields(kind) if "float" in str(f.type)}
    assert numbers <= set(HARD_LIMITS[kind.__name__])
    assert {settings for settings, _, _ in bad_settings()} == set(NEEDS)


def test_the_two_settings_that_once_moved_the_arm_out_of_its_box() -> None:
    with pytest.raises(ContractError, match=r"GuardLimits\.step_m.*above 0 to 0\.1.*-0\.05"):
        GuardLimits(step_m=-0.05)
    with pytest.raises(ContractError, match=r"GuardLimits\.longest_gap_s.*-1"):
        GuardLimits(longest_gap_s=-1)


def test_our_own_gains_stay_below_the_force_limit() -> None:
    for gains in (ROLLOUT, HAND_GUIDED):
        assert max(k * c for k, c in zip(gains.stiffness_N_m, gains.clip_m, strict=True)) < FORCE_N
    StreamSettings()
