"""Every recipe of the plan becomes a training run; the plan's arms find their checkpoints."""

import json
from pathlib import Path

import pytest

from benchmarks import train_arm as module
from benchmarks.train_arm import TrainArmConfig, arguments, train_arm
from benchmarks.wiping_plan import ARMS, RECIPES
from uniforce_cli.score import SCRIPTS
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import VIEW_MARKER


@pytest.fixture
def view(tmp_path: Path) -> Path:
    folder = tmp_path / "view"
    folder.mkdir()
    episodes = [{"left_sensor": rig} for rig in ("gelsight", "uskin", "gelsight", "uskin", "uskin")]
    (folder / VIEW_MARKER).write_text(json.dumps({"episodes": episodes}))
    return folder


def test_every_arm_has_a_recipe_and_every_recipe_an_arm() -> None:
    assert {arm.checkpoint for arm in ARMS} - set(SCRIPTS) == set(RECIPES)


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_a_recipe_trains_on_its_rigs_demos(name: str, view: Path, tmp_path: Path) -> None:
    given = arguments(TrainArmConfig(name=name, view=str(view)), RECIPES[name], tmp_path / "run")
    wanted = {"vtg": [0, 2], "vtu": [1, 3, 4]}.get(name, [0, 1, 2, 3, 4])
    assert f"dataset.episodes={wanted}" in given
    assert f"policy.touch.input={RECIPES[name].touch_input}" in given and "policy.recipe=scored" in given


def test_fewer_demos_are_the_first_of_each_rig(view: Path, tmp_path: Path) -> None:
    given = arguments(TrainArmConfig(view=str(view), demos=2), RECIPES["vt"], tmp_path / "run")
    assert "dataset.episodes=[0, 1, 2, 3]" in given
    with pytest.raises(DatasetError, match="at most 2"):
        arguments(TrainArmConfig(view=str(view), demos=3), RECIPES["vt"], tmp_path / "run")


def test_a_run_is_resumed_and_a_finished_one_left_alone(
    view: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[list[str]] = []
    last = tmp_path / "runs" / "vt_seed1" / "checkpoints" / "000002" / "pretrained_model"

    def fake(argv: list[str]) -> None:
        calls.append(argv)
        last.mkdir(parents=True, exist_ok=True)
        link = last.parent.parent / "last"
        if not link.exists():
            link.symlink_to(last.parent.name)
        (last / "train_config.json").write_text("{}")
        if len(calls) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(module.lerobot_training, "train", fake)
    config = TrainArmConfig(view=str(view), seed=1, out=str(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        train_arm(config)
    done = train_arm(config)
    assert "resume=true" in calls[1] and done == tmp_path / "seed1" / "vt"
    assert (done / "train_config.json").exists()
    assert train_arm(config) == done and len(calls) == 2
