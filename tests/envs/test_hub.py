"""The scene as EnvHub loads it: LeRobot's own loader reads env.py out of a hub cache."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from huggingface_hub import ModelCard
from lerobot.envs.factory import make_env

from lerobot_env_uniforce_wiping.levels import TOUCH
from uniforce_cli import share
from uniforce_vtla.keys import ACTION

REPOSITORY = "somebody/wipe-by-touch"
COMMIT = "c" * 40


@pytest.fixture
def hub_cache(tmp_path, monkeypatch):
    """A hub cache that holds the shared scene at one commit."""
    hub = Mock(create_repo=lambda repo_id, **_: SimpleNamespace(repo_id=repo_id))
    monkeypatch.setattr("huggingface_hub.HfApi", lambda: hub)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    of_repository = tmp_path / f"models--{REPOSITORY.replace('/', '--')}"
    snapshot = of_repository / "snapshots" / COMMIT
    assert share.main(["scene=true", f"out={snapshot}", f"push={REPOSITORY}"]) == 0
    (of_repository / "refs").mkdir()
    (of_repository / "refs" / "main").write_text(COMMIT)
    return tmp_path


def test_lerobot_makes_the_scene_from_a_hub_repository(hub_cache):
    made = make_env(REPOSITORY, n_envs=2, hub_cache_dir=str(hub_cache), trust_remote_code=True)
    scenes = made["uniforce_wiping"][0]
    observation, _ = scenes.reset(seed=[3, 4])
    assert scenes.num_envs == 2 and scenes.call("task_description") == scenes.call("task")
    assert scenes.get_attr("level") == (TOUCH, TOUCH)
    observation, *_, info = scenes.step(np.zeros(scenes.action_space.shape, np.float32))
    assert observation["pixels"]["tactile_right"].shape == (2, 480, 640, 3)
    assert not info["is_success"].any()
    scenes.close()


def test_nothing_is_run_without_consent(hub_cache):
    with pytest.raises(RuntimeError, match="trust_remote_code"):
        make_env(REPOSITORY, hub_cache_dir=str(hub_cache))


def test_its_card_parses_and_names_its_repository(hub_cache):
    card = ModelCard.load(next(hub_cache.rglob("README.md")))
    assert card.data.license == "apache-2.0" and card.data.library_name == "lerobot"
    assert REPOSITORY in card.text and ACTION in card.text
