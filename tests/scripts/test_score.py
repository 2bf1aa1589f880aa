"""Arms of a score take turns, resume, and are with_control; scripts are scored as policies are."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import joblib
import numpy as np
import pytest
from episode_samples import good_row
from policy_samples import calibrate

from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config
from uniforce_cli import score as score_module
from uniforce_cli import score_worker
from uniforce_cli.boundary import Worn
from uniforce_cli.score import ROWS, SCRIPTS, ScoreConfig, score, score_arms, write_report
from uniforce_cli.score_worker import (
    FrozenTouch,
    score_job,
    with_control,
)
from uniforce_vtla.contact.virtual import hidden_sensors
from uniforce_vtla.errors import ContractError
from uniforce_vtla.json_file import read_object
from uniforce_vtla.results_file import only_writer


@pytest.fixture
def rolled_out(monkeypatch):
    """Let a rule say whether an episode is clean, instead of rolling it out; return what was asked
    for."""

    def stand_in(clean=lambda *_: True):
        jobs = []

        def fake(index, config, seed):
            jobs.append((seed, config))
            return index, good_row(seed, clean(seed, config))

        monkeypatch.setattr(score_worker, "score_job", fake)
        return jobs

    return stand_in


@pytest.fixture
def settings(tmp_path):
    """Settings of five rollouts from seed 5 on."""
    return ScoreConfig(rollouts=5, first_seed=5, workers=1, out=str(tmp_path))


def scored(*arms):
    return score_arms(arms, workers=1)


def test_a_script_is_not_taken_for_a_policy():
    assert ScoreConfig().arm == "policy"
    assert ScoreConfig(policy="expert").arm == "expert"
    assert ScoreConfig(policy="expert", arm="me").arm == "me"


@pytest.mark.parametrize(
    "options, arm, folder",
    [
        ({}, "policy", "policy_gelsight+tactip_touch"),
        (
            {"right_sensor": "uskin:7+lag=100", "control": "masked"},
            "policy, right uskin:7+lag=100, masked",
            "policy-right-uskin-7lag-100-masked_gelsight+uskin-7+lag-100_touch_masked",
        ),
        (
            {
                "left_sensor": "tactip",
                "right_calibration": "map",
                "gripper": "servo",
                "swap": "touch0:left",
                "monitor": "off",
                "level": "easy",
            },
            "policy, left tactip, right calibrated, servo, unwatched, touch0:left",
            "policy-left-tactip-right-calibrated-servo-unwatched-touch0-left"
            "_tactip+tactip_easy_servo_touch0-left_right-calibrated_unwatched",
        ),
    ],
)
def test_an_arm_and_its_folder_are_named_after_the_rig(options, arm, folder):
    config = ScoreConfig(**options)
    assert (config.arm, config.folder) == (arm, Path("outputs/score") / folder)


def test_training_seeds_take_turns_from_scene_to_scene(settings, rolled_out):
    rolled_out(lambda seed, config: "seed0" in config.policy_of(seed))
    config = replace(settings, policy="seed0/v, seed1/v", arm="V")
    assert config.policies == ["seed0/v", "seed1/v"]
    (report,) = scored(config)
    assert [row.clean for row in report.rows] == [True, False, True, False, True]


def test_arms_take_turns_and_a_second_run_does_nothing(settings, rolled_out):
    jobs = rolled_out()
    arms = [replace(settings, arm=arm, rollouts=2) for arm in ("V", "V+T")]
    turns = [(5, "V"), (5, "V+T"), (6, "V"), (6, "V+T")]
    for _ in range(2):
        reports = scored(*arms)
        assert [(seed, config.arm) for seed, config in jobs] == turns
    assert [r.count("clean") for r in reports] == [2, 2]


def test_a_scored_seed_is_rolled_out_again_to_be_filmed_and_only_once(settings, rolled_out):
    def filmed(seed, config):
        if seed in config.film:
            config.video(seed).touch()
        return True

    jobs = rolled_out(filmed)
    plain = replace(settings, rollouts=3)
    scored(plain)
    for _ in range(2):
        (report,) = scored(replace(plain, film=[6]))
        assert [seed for seed, _ in jobs] == [5, 6, 7, 6] and report.n == 3
    with pytest.raises(ContractError, match="5…7"):
        scored(replace(plain, film=[8]))


def test_episodes_of_another_policy_are_neither_taken_over_nor_lost(settings, tmp_path, rolled_out):
    jobs, trained = rolled_out(), tmp_path / "trained"
    trained.mkdir()
    (trained / "config.json").write_text("{}")
    (trained / "model.safetensors").write_bytes(b"before")
    config = replace(settings, policy=str(trained), rollouts=1)
    scored(config)
    (trained / "README.md").write_text("a card changes nothing")
    scored(config)
    assert len(jobs) == 1
    (trained / "model.safetensors").write_bytes(b"trained again")
    for _ in range(2):
        with pytest.raises(ContractError, match=r"of this policy and calibration.*resume=false"):
            scored(config)
    scored(replace(config, resume=False))
    assert len(jobs) == 2


def test_episodes_of_other_code_are_kept_with_a_warning(settings, rolled_out, monkeypatch, caplog):
    rolled_out()
    for commit in ("one", "one", "another"):
        monkeypatch.setattr(
            score_module, "provenance", lambda commit=commit: {"commit": commit, "version": "1"}
        )
        assert "other code" not in caplog.text
        scored(settings)
    assert "episodes of other code are kept" in caplog.text
    write_report(settings)
    (arm,) = read_object(Path(settings.out) / "wiping.json", ContractError)["arms"].values()
    assert arm["commits"] == ["one", "another"]


def test_two_rigs_of_one_name_are_refused_before_a_rollout(settings, rolled_out):
    jobs = rolled_out()
    other = replace(settings, arm="swap", right_sensor="uskin:drawing")
    score(other)
    asked = len(jobs)
    with pytest.raises(ContractError, match="arm=swap: expected a name of its own"):
        score(replace(other, right_sensor="gelsight:drawing"))
    assert len(jobs) == asked


def test_a_folder_that_is_no_arm_is_left_out_of_the_table(settings, tmp_path, rolled_out):
    rolled_out()
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "config.json").write_text("{}")
    scored(settings)
    assert len(write_report(settings)) == 1


def test_a_table_holds_the_scenes_that_were_asked_for_last(settings, rolled_out):
    jobs = rolled_out()
    for first, rollouts in ((5, 3), (100, 2), (5, 2)):
        config = replace(settings, rollouts=rollouts, first_seed=first)
        scored(config)
        (report,) = write_report(config)
        assert [row.seed for row in report.rows] == list(config.seeds)
    assert len(jobs) == 5  # the last two were scored before


def test_two_processes_do_not_score_into_one_folder(settings, rolled_out):
    jobs = rolled_out()
    with only_writer(settings.folder / ROWS), pytest.raises(ContractError, match="another one too"):
        scored(settings)
    assert not jobs and scored(settings)[0].n == 5


def test_a_slot_the_policy_lacks_is_refused_before_processes_start(settings, rolled_out):
    jobs = rolled_out()
    with pytest.raises(ContractError, match="touch0"):
        score(replace(settings, swap="nose:left"))
    assert not jobs


@pytest.mark.parametrize("name", sorted(hidden_sensors()))
def test_a_sensor_that_no_table_lists_can_be_worn(name):
    Worn.__metadata__[0].check("right_sensor", f"{name}:any")


def test_the_calibration_of_another_unit_is_refused(settings, tmp_path, rolled_out):
    jobs, policy = rolled_out(), stored_config(shipped_checkpoint())
    folder = calibrate(tmp_path / "map", policy, new="uskin:1", anchor="tactip:1")
    config = replace(settings, right_calibration=folder, rollouts=1)
    for words in ("uskin", "uskin:1+lag=100"):
        score(replace(config, right_sensor=words, arm=""))
    assert len(jobs) == 2
    with pytest.raises(ContractError, match=r"one of uskin:2, got one of uskin:1"):
        score(replace(config, right_sensor="uskin:2"))
    assert len(jobs) == 2


def test_two_dask_workers_score_as_one_process_does(settings, tmp_path):
    """An extra: joblib's Dask back-end carries rollouts over a cluster."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is optional")
    plain = replace(settings, policy="expert", level="easy", rollouts=2, videos=0)
    one = scored(plain)
    how = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**how) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        two = score_arms([replace(plain, out=str(tmp_path / "two"))], workers=2)
    assert [report.as_dict() for report in one] == [report.as_dict() for report in two]


def test_every_script_can_be_scored():
    assert set(score_worker.SCRIPTS) == set(SCRIPTS)


def test_frozen_touch_stays_as_it_was_half_a_second_into_the_wipe():
    inner = MagicMock()
    frozen = FrozenTouch(inner)
    for phase, time_s, shown in ((1, 1.0, 1), (2, 1.1, 1), (2, 1.4, 1), (2, 1.6, 0), (3, 2.0, 0)):
        env = SimpleNamespace(phase=phase, trace=SimpleNamespace(time_s=np.array([time_s])))
        if phase == 1:
            frozen.reset(env)
        frozen._env = env
        pixels = {"front": np.full(1, time_s), "tactile_right": np.full(1, time_s)}
        frozen.chunk({"pixels": pixels}, "wipe")
        seen = inner.chunk.call_args.args[0]["pixels"]
        assert seen["front"] == time_s and seen["tactile_right"] == (time_s if shown else 1.4)


def test_unknown_controls_and_controls_of_scripts_are_refused(settings):
    with pytest.raises(ContractError, match="masked"):
        with_control(None, "asleep")
    with pytest.raises(ContractError, match="Controls are for policies"):
        score_job(0, replace(settings, policy="expert", control="masked"), 1)


def test_a_sensor_that_fails_at_the_first_look_makes_an_aborted_row(settings, caplog):
    _, row = score_job(0, replace(settings, right_sensor="tactip:1+light=0"), 10_000)
    assert (row.code, row.seconds, row.residual) == ("a", 0.0, 1.0)
    assert "scene 10000 is aborted: tactip on the right finger" in caplog.text
