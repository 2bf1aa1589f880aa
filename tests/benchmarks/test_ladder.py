"""The plan of the swap ladder: names fit together, rows wait for what is missing, claims get
verdicts."""

import json
from pathlib import Path
from unittest.mock import Mock

import pytest
from episode_samples import good_row

from benchmarks import calibrations
from benchmarks.ladder import __main__ as ladder
from benchmarks.ladder.plan import BETTER, CLAIMS, LADDER, Row
from benchmarks.scene_blocks import BLOCKS
from uniforce_cli.score_settings import ScoreConfig
from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.evaluation.arms import ArmReport

BLOCK = BLOCKS["swap ladder in the hand's rig"]


def row(codes):
    seeds = [BLOCK.start, BLOCK.start + len(codes) - 1]
    return {"n": len(codes), "clean": codes.count("C"), "seeds": seeds, "by_seed": codes}


def named_folder(worn, fit, work, finger):
    return work / fit / finger / worn


def test_the_plan_names_rows_that_exist_and_scenes_of_one_block():
    names = {row.name for row in LADDER}
    assert len(names) == len(LADDER), "two rows of one name"
    assert {claim.first for claim in CLAIMS} | {claim.second for claim in CLAIMS} <= names
    assert {name for pair in BETTER for name in pair} <= names
    assert max(row.rollouts for row in LADDER) <= len(BLOCK)
    assert all(row.rollouts % len(row.worn) == 0 for row in LADDER)


def test_rows_wait_for_checkpoints_and_wear_their_units_in_turns(tmp_path, monkeypatch):
    monkeypatch.setattr(ladder, "calibration_folder", named_folder)
    config = ladder.LadderCommand(checkpoints=str(tmp_path), work="work")
    wanted = Row("S2", "latent/seed*", ("uskin:2", "uskin:3"), "grasps")
    assert not ladder.configured(config, wanted)
    for seed in (0, 1):
        (tmp_path / f"latent/seed{seed}").mkdir(parents=True)
    first, second = ladder.configured(config, wanted)
    assert (first.right_sensor, second.right_sensor) == ("uskin:2", "uskin:3")
    assert second.right_calibration == str(Path("work/grasps/right/uskin:3"))
    assert first.gripper == second.gripper == "hand"
    assert [Path(policy).name for policy in first.policies] == ["seed0", "seed1"]
    assert [*first.seeds, *second.seeds] == list(BLOCK[:204])


def test_both_fingers_wear_other_units_each_calibrated(tmp_path, monkeypatch):
    monkeypatch.setattr(ladder, "calibration_folder", named_folder)
    (tmp_path / "latent/seed0").mkdir(parents=True)
    both = Row("S2", "latent/seed*", ("uskin:2", "uskin:3"), "grasps", ("uskin:4", "uskin:5"))
    config = ladder.LadderCommand(checkpoints=str(tmp_path), work="work")
    first, second = ladder.configured(config, both)
    assert (first.left_sensor, second.left_sensor) == ("uskin:4", "uskin:5")
    assert first.left_calibration == str(Path("work/grasps/left/uskin:4"))
    assert first.right_calibration == str(Path("work/grasps/right/uskin:2"))
    own = Row("S0", "latent/seed*")
    (alone,) = ladder.configured(config, own)
    assert alone.left_sensor == "gelsight"
    assert not alone.left_calibration and not alone.right_calibration


def test_a_part_without_any_checkpoint_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match="checkpoints of the plan"):
        ladder.scored(ladder.LadderCommand(checkpoints=str(tmp_path)))


def test_a_rows_parts_are_joined_and_counted_by_training_seed():
    configs = [
        ScoreConfig(policy="a/seed0,a/seed1", arm="S2", first_seed=first, rollouts=4)
        for first in (10, 14)
    ]
    reports = []
    for config in configs:
        reports.append(ArmReport("S2", [good_row(scene, scene % 2 == 0) for scene in config.seeds]))
    found = ladder.joined(configs, reports)["S2"]
    assert found["seeds"] == [10, 17]
    assert found["by_seed"] == "CsCsCsCs"
    assert found["clean_by_training_seed"] == {"seed0": "4/4", "seed1": "0/4"}


def test_a_claim_holds_within_its_margin_and_bound():
    good = row("C" * 190 + "r" * 14)
    poor = row("C" * 150 + "r" * 54)
    (held,) = ladder.claims({"S0": good, "S1 weighed": good})
    (broken,) = ladder.claims({"S0": good, "S1 weighed": poor})
    assert held["holds"] and held["difference"] == 0 and not broken["holds"]


def test_rows_scored_later_join_those_of_the_result_file(tmp_path, monkeypatch):
    out = tmp_path / "swap.json"
    there = [f"checkpoints={tmp_path}"]
    full = {"clean_by_training_seed": {"seed0": "4/4"}}
    monkeypatch.setattr(ladder, "scored", lambda config: {config.rows: row("CCCC") | full})
    for name in ("S0", "S1 weighed"):
        assert ladder.main([f"rows={name}", f"out={out}", f"work={tmp_path}", *there]) == 0
    found = json.loads(out.read_text())
    assert list(found["rows"]) == ["S0", "S1 weighed"]
    assert found["within"][0]["arms"] == ["S1 weighed", "S0"]


def test_a_calibration_is_made_once(tmp_path, monkeypatch):
    calibrate = Mock()
    calibrate.return_value.save = lambda folder: folder.mkdir(parents=True)
    monkeypatch.setattr(calibrations, "calibrate_sensor", calibrate)
    for _ in range(2):
        calibrations.calibration_folder("uskin:2", "grasps", tmp_path)
    ((command, _),) = [call.args for call in calibrate.call_args_list]
    assert (command.new, command.anchor, command.grasps) == ("uskin:2", "tactip", 300)


def test_a_left_fingers_calibration_is_fitted_beside_its_known_sensor(tmp_path, monkeypatch):
    calibrate = Mock()
    monkeypatch.setattr(calibrations, "calibrate_sensor", calibrate)
    folder = calibrations.calibration_folder("uskin:2", "grasps", tmp_path, "left")
    assert folder != calibrations.calibration_folder("uskin:2", "grasps", tmp_path)
    assert [call.args[0].anchor for call in calibrate.call_args_list] == ["gelsight", "tactip"]
