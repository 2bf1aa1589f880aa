"""The wiping plan: recipes become training runs, arms find their checkpoints, the table is what its letters say."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import train_arm as module
from benchmarks.train_arm import TrainArmConfig, arguments, train_arm
from benchmarks.wiping import draw_z_profiles
from benchmarks.wiping_plan import ARMS, AS_GOOD, BETTER, RECIPES
from uniforce_cli.score import SCRIPTS
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.sensors import list_sensors


@pytest.fixture
def view(tmp_path: Path) -> Path:
    folder = tmp_path / "view"
    folder.mkdir()
    episodes = [{"left_sensor": rig} for rig in ("gelsight", "uskin", "gelsight", "uskin", "uskin")]
    (folder / VIEW_MARKER).write_text(json.dumps({"episodes": episodes}))
    return folder


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


def test_a_run_is_resumed_and_a_finished_one_left_alone(view: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
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


ROW = EpisodeRow(0, "success", True, False, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0)


def test_the_plan_names_every_arm_once_and_asks_only_about_those() -> None:
    names = [a.name for a in ARMS]
    assert len(set(names)) == len(names)
    asked = {name for pair in BETTER for name in pair} | {n for c in AS_GOOD for n in (c.first, c.second)}
    assert asked <= set(names)
    assert {a.left for a in ARMS} | {a.right for a in ARMS} <= set(list_sensors())
    assert {a.checkpoint for a in ARMS} == {*RECIPES, *SCRIPTS}


def test_a_swap_uses_its_partners_checkpoint() -> None:
    by_name = {a.name: a for a in ARMS}
    swaps = [claim for claim in AS_GOOD if "swapped" in claim.about]
    assert len(swaps) == 3
    for swap in swaps:
        assert by_name[swap.first].checkpoint == by_name[swap.second].checkpoint


def test_profiles_are_drawn_also_where_an_arm_never_wiped(tmp_path: Path) -> None:
    wiped = ArmReport("V+T", [replace(ROW, z_profile_mm=tuple(float(z) for z in range(60)))] * 3)
    path = draw_z_profiles([wiped, ArmReport("V", [ROW])], tmp_path / "z.png")
    assert path.stat().st_size > 1000
    assert draw_z_profiles([ArmReport("V", [ROW])], tmp_path / "none.png").exists()
