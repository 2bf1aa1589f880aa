"""No number of the robot's settings goes beyond the hard limits, and every number has one."""

from dataclasses import fields
from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.trust.guards import NEEDS, bad_settings, try_all
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.arm import Gains
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.limits import FORCE_N, HARD_LIMITS, HandSettings, StreamSettings
from uniforce_robots.franka.poses import ToolPose
from uniforce_vtla.errors import ContractError


def test_every_bad_setting_is_refused_by_name():
    found = try_all()
    assert found["accepted"] == [] and found["tried"] >= 60


@pytest.mark.parametrize("kind", NEEDS, ids=lambda kind: kind.__name__)
def test_every_number_has_a_hard_limit(kind):
    numbers = {f.name for f in fields(kind) if "float" in str(f.type)}
    assert numbers <= set(HARD_LIMITS[kind.__name__])
    assert {settings for settings, _, _ in bad_settings()} == set(NEEDS)


CEILINGS = [  # said once more, in numbers: a limit that is lifted in the table fails here
    (GuardLimits, {"step_m": 0.101, "step_rad": 0.81, "speed_m_s": 0.51, "speed_rad_s": 2.51}),
    (GuardLimits, {"speed_width_m_s": 0.21, "longest_gap_s": 0.21, "tilt_rad": 0.36}),
    (GuardLimits, {"high": (0.91, 0.3, 0.5, 1.5, 0.08)}),
    (partial(Gains, (2000.0,) * 3), {"clip_m": (0.0213,) * 3}),
    (Gains, {"stiffness_N_m": (3001.0, 800.0, 800.0)}),
    (HandSettings, {"grip_force_N": 41, "reading_age_s": 1.1}),
    (StreamSettings, {"stale_s": 1.1, "state_age_s": 1.1}),
    (UniforceFrankaConfig, {"reflex_force_N": 101, "reflex_torque_Nm": 101, "fps": 101}),
]


@pytest.mark.parametrize("make, too_much", CEILINGS)
def test_the_ceilings_in_numbers(make, too_much):
    for name, value in too_much.items():
        with pytest.raises(ContractError):
            make(**{name: value})


def test_a_setting_that_was_changed_later_is_refused_by_the_robot(tmp_path):
    config = UniforceFrankaConfig(id="a", calibration_dir=tmp_path)
    config.fps = 1000.0
    with pytest.raises(ContractError, match=r"UniforceFrankaConfig\.fps.*1000"):
        UniforceFranka(config)


@given(
    st.tuples(*[st.floats(0, 3000)] * 3),
    st.tuples(*[st.floats(0, 0.05)] * 3),
    st.floats(-np.pi, np.pi),
)
def test_no_gains_pull_harder_than_the_force_limit_however_the_hand_is_turned(
    stiffness, clip, yaw_rad
):
    try:
        gains = Gains(stiffness, clip_m=clip)
    except ContractError:
        return
    errors_m = clip * np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    K = gains.matrix_in_base(ToolPose(np.zeros(3), yaw_rad).ee_to_base()[:3, :3])[:3, :3]
    assert np.linalg.norm(errors_m @ K.T, axis=1).max() <= FORCE_N + 1e-9
