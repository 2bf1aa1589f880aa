"""The checkpoints that come with the source are the plan's: they load, and were trained as it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.wiping_plan import RECIPES
from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.stored_policy import stored_config
from uniforce_commands.benchmark import BenchmarkConfig
from uniforce_commands.train_arm import CAMERA_VARIATION, DELTA_KNEE, EXECUTED, TOLD_AXES

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / BenchmarkConfig().checkpoints
FOLDERS = sorted(config.parent for config in SHIPPED.parent.glob("*/*/config.json"))


def test_the_benchmark_finds_them() -> None:
    assert SHIPPED in {folder.parent for folder in FOLDERS}


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: f"{folder.parent.name}/{folder.name}")
def test_it_was_trained_as_the_plan_says(folder: Path) -> None:
    recipe, config = RECIPES[folder.name], stored_config(folder)
    assert config.size == "tiny" and config.touch_input == recipe.touch_input
    if recipe.touch_input != "none":
        assert config.finger_by_slot() == dict(recipe.slots)
    assert config.state_noise == list(recipe.state_noise)
    assert config.sensor_transfer == recipe.sensor_transfer
    assert config.touch_directions == recipe.touch_directions
    assert recipe.touch_noise in (None, config.touch_noise)
    assert list(config.delta_knee) == list(DELTA_KNEE)
    assert config.n_action_steps == config.last_move_steps == EXECUTED
    assert config.told_axes == list(TOLD_AXES) and config.camera_variation == CAMERA_VARIATION
    PI05UniforcePolicy.from_pretrained(folder, config=config)  # strict: every weight is there
