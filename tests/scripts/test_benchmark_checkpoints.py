"""The checkpoints that come with the source are the plan's: they load, and were trained as it says."""

from pathlib import Path

import pytest

from benchmarks.wiping import BenchmarkConfig
from benchmarks.wiping_plan import RECIPES
from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig, TouchSettings
from lerobot_policy_pi05_uniforce.controller import stored_config

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / BenchmarkConfig().checkpoints
FOLDERS = sorted(config.parent for config in SHIPPED.parent.glob("*/*/config.json"))


def test_the_benchmark_finds_them() -> None:
    assert SHIPPED in {folder.parent for folder in FOLDERS}


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: f"{folder.parent.name}/{folder.name}")
def test_it_was_trained_as_the_plan_says(folder: Path) -> None:
    plan, config = RECIPES[folder.name], stored_config(folder)
    touch = TouchSettings(input=plan.touch_input, slots=dict(plan.slots))
    wanted = PI05UniforceConfig(size="tiny", recipe="scored", device="cpu", touch=touch)
    assert (config.size, config.recipe, config.n_action_steps) == ("tiny", "scored", wanted.n_action_steps)
    assert config.augment == wanted.augment and config.touch.directions == wanted.touch.directions
    assert (config.touch.input, config.finger_by_slot()) == (plan.touch_input, dict(plan.slots))
    wanted.action.target_range = config.action.target_range  # of the demos
    assert config.action == wanted.action
    PI05UniforcePolicy.from_pretrained(folder, config=config)  # strict: every weight is there
