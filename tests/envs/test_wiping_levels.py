from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, draw_scene, level_hash
from lerobot_env_uniforce_wiping.hidden import (
    BOARD_HALF_m,
    PullSettings,
    UnevenBoard,
    UnevenSettings,
    hand_pull,
)
from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.sequence import Sweep
from uniforce_vtla.sensors.layouts import turned

LOCKED = {"easy": "a6e6bd6055b0", "touch": "21ea3966703a"}


def test_levels_are_locked():
    """A changed level makes old scores incomparable: give it a new name, or score anew."""
    assert {name: level_hash(level) for name, level in LEVELS.items()} == LOCKED


@examples(30)
@given(st.integers(0, 2**31 - 1), st.sampled_from(sorted(LEVELS)))
def test_scene_is_a_function_of_seed_and_level(seed, level):
    scene = draw_scene(seed, level)
    assert scene == draw_scene(seed, level)
    assert asdict(scene) != asdict(draw_scene(seed + 1, level))


@pytest.mark.parametrize("name", sorted(LEVELS))
def test_serpentine_is_readable_from_position_alone(name):
    """Row k runs +y where k is even, back where it is odd: x decides the direction."""
    level = LEVELS[name]
    start, stop = Sweep(level).corners.reshape(level.rows, 2, 2).swapaxes(0, 1)
    rows = np.arange(level.rows)
    for ends in (start, stop):
        np.testing.assert_allclose(ends[:, 0], start[0, 0] + rows * level.row_pitch_m)
    assert np.array_equal(stop[:, 1] > start[:, 1], rows % 2 == 0)
    narrowest = level.layout.eraser_width_m + level.eraser_width_offset_m[0]
    assert level.row_pitch_m < narrowest


def test_stiffness_is_as_likely_twice_as_half_its_middle():
    low, high = LEVELS["touch"].stiffness_scale
    drawn = np.array([draw_scene(seed, "touch").stiffness_scale for seed in range(400)])
    assert drawn.min() >= low and drawn.max() <= high
    # three standard errors
    assert (drawn < np.sqrt(low * high)).mean() == pytest.approx(0.5, abs=0.08)


@examples(40)
@given(st.integers(0, 2**31 - 1), st.sampled_from(sorted(LEVELS)))
def test_writing_of_any_size_and_place_lies_where_the_eraser_goes(seed, name):
    """Every cell of the word is under the swept band, whatever the board's place and turn."""
    scene = draw_scene(seed, name)
    level = LEVELS[name]
    ink = InkField(scene)
    places_m = np.column_stack([ink.x_m[ink.ink > 0], ink.y_m[ink.ink > 0]])
    away_m = np.abs(turned(places_m, scene.board_turn_rad) + scene.board_shift_m).max(axis=0)
    half_band = (level.rows - 1) * level.row_pitch_m / 2 + scene.eraser_width_m / 2
    assert away_m[0] < half_band
    assert away_m[1] < level.stroke_m / 2  # under the whole length of the eraser


def test_scenes_vary_what_a_camera_sees():
    scenes = [draw_scene(seed, "touch") for seed in range(40)]
    assert len({scene.word for scene in scenes}) > 10
    numbers = ("letter_scale", "board_turn_rad", "eraser_turn_rad", "eraser_length_m", "light_gain")
    for name in numbers:
        assert len({getattr(scene, name) for scene in scenes}) == len(scenes)


def test_light_changes_the_picture_and_nothing_else():
    def lit(gain):
        env = WipeEnv("touch")
        env.start(1)
        env.sim.scene = replace(env.scene, light_gain=(gain,) * 3, light_turn_rad=(0.0,) * 3)
        env._painter.reset(env.sim)
        return env.observe()

    dark = lit(0.7)
    light = lit(1.0)
    ratio = dark["pixels"]["front"].mean() / light["pixels"]["front"].mean()
    assert ratio == pytest.approx(0.7, abs=0.03)
    assert np.array_equal(dark["pixels"]["tactile_left"], light["pixels"]["tactile_left"])
    assert np.array_equal(dark["agent_pos"], light["agent_pos"])


def test_the_pull_has_its_spread_its_pace_and_its_bound():
    # (40, 900, 3)
    pulls = np.stack([hand_pull(seed, PullSettings(), 900, 30.0) for seed in range(40)])
    assert pulls.std() == pytest.approx(3.0 * 0.88, rel=0.1)  # clipping at two sd takes an eighth
    assert np.abs(pulls).max() == pytest.approx(6.0)
    assert np.abs(np.diff(pulls, axis=1)).max() < 0.8, "no jump within a step"
    later = pulls[:, 48:].ravel(), pulls[:, :-48].ravel()  # 1.6 s apart: exp(-1.6² / 4·0.8²) = 0.37
    assert np.corrcoef(*later)[0, 1] == pytest.approx(0.37, abs=0.12)


def test_the_board_has_its_spread_and_its_length():
    boards = [UnevenBoard(seed, UnevenSettings()) for seed in range(60)]

    def heights_m(x_m, y_m):
        return np.array([board.height_m(np.array([x_m, y_m])) for board in boards])

    here = heights_m(0.0, 0.0)
    assert here.std() == pytest.approx(0.00085 * 0.88, rel=0.25)
    correlation = np.corrcoef(here, heights_m(0.0, 0.03))[0, 1]
    assert correlation == pytest.approx(0.61, abs=0.25)  # exp(-1/2)
    np.testing.assert_allclose(heights_m(1.0, 0.0), heights_m(BOARD_HALF_m[0], 0.0))
