"""Arms of a score take turns, resume, and are controlled; scripts are scored as policies are."""

import dataclasses
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import joblib
import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config
from uniforce_cli import score_worker
from uniforce_cli.score import ROWS, SCRIPTS, ScoreConfig, score, score_arms, write_report
from uniforce_cli.score_settings import Rig
from uniforce_cli.score_worker import (
    FrozenTouch,
    ShuffledTouch,
    controlled,
    donated_touch,
    score_job,
)
from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.arms import EpisodeRow
from uniforce_vtla.keys import TACTILE_NAMES
from uniforce_vtla.results_file import only_writer
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent_map import LatentMap


@pytest.fixture
def rolled_out(monkeypatch):
    """Let a rule say whether an episode is clean, instead of rolling it out; return what was asked for."""

    def stand_in(clean):
        jobs = []

        def fake(index, config, seed):
            jobs.append((seed, config))
            return index, EpisodeRow(
                seed, "success", clean(seed, config), False, False, 0, 0, 0, 0, 0, 0
            )

        monkeypatch.setattr(score_worker, "score_job", fake)
        return jobs

    return stand_in


def test_a_script_is_not_taken_for_a_policy():
    assert ScoreConfig().arm == "V+T"
    assert ScoreConfig(policy="expert").arm == "expert"
    assert ScoreConfig(policy="expert", arm="me").arm == "me"


@pytest.mark.parametrize(
    "options, arm, folder",
    [
        ({}, "V+T", "VT_gelsight+tactip_touch"),
        (
            {"right_sensor": "uskin:7+lag=100", "control": "masked"},
            "V+T, right uskin:7+lag=100, masked",
            "VT-right-uskin-7lag-100-masked_gelsight+uskin-7+lag-100_touch_masked",
        ),
        (
            {
                "left_sensor": "tactip",
                "right_calibration": "map",
                "gripper": "hand",
                "grip": "held",
                "swap": "touch0:left",
                "monitor": "off",
                "level": "easy",
            },
            "V+T, left tactip, right calibrated, grip held, hand, unwatched, touch0:left",
            "VT-left-tactip-right-calibrated-grip-held-hand-unwatched-touch0-left"
            "_tactip+tactip_easy_hand_grip-held_touch0-left_right-calibrated_unwatched",
        ),
    ],
)
def test_an_arm_and_its_folder_are_named_after_the_rig(options, arm, folder):
    config = ScoreConfig(**options)
    assert (config.arm, config.folder) == (arm, Path("outputs/score") / folder)


def test_training_seeds_take_turns_from_scene_to_scene(tmp_path, rolled_out):
    rolled_out(lambda seed, config: "seed0" in config.policy_of(seed))
    config = ScoreConfig(policy="seed0/v, seed1/v", arm="V", rollouts=5, out=str(tmp_path))
    assert config.policies == ["seed0/v", "seed1/v"]
    (report,) = score_arms([config], workers=1)
    assert [row.clean for row in report.rows] == [True, False, True, False, True]


def test_arms_take_turns_and_a_second_run_does_nothing(tmp_path, rolled_out):
    jobs = rolled_out(lambda *_: True)
    vision = ScoreConfig(arm="V", rollouts=2, first_seed=5, out=str(tmp_path))
    arms = [vision, dataclasses.replace(vision, arm="V+T")]
    turns = [(5, "V"), (5, "V+T"), (6, "V"), (6, "V+T")]
    for _ in range(2):
        reports = score_arms(arms, workers=1)
        assert [(seed, config.arm) for seed, config in jobs] == turns
    assert [r.count("clean") for r in reports] == [2, 2]


def test_a_scored_seed_is_rolled_out_again_to_be_filmed_and_only_once(tmp_path, rolled_out):
    def filmed(seed, config):
        if seed in config.film:
            config.video(seed).touch()
        return True

    jobs = rolled_out(filmed)
    plain = ScoreConfig(arm="V", rollouts=3, first_seed=5, out=str(tmp_path))
    score_arms([plain], workers=1)
    for _ in range(2):
        reports = score_arms([dataclasses.replace(plain, film=[6])], workers=1)
        assert [seed for seed, _ in jobs] == [5, 6, 7, 6] and reports[0].n == 3
    with pytest.raises(ContractError, match="5…7"):
        score_arms([dataclasses.replace(plain, film=[8])], workers=1)


def test_episodes_of_another_policy_are_neither_taken_over_nor_lost(tmp_path, rolled_out):
    jobs, trained = rolled_out(lambda *_: True), tmp_path / "trained"
    trained.mkdir()
    (trained / "config.json").write_text("{}")
    (trained / "model.safetensors").write_bytes(b"before")
    config = ScoreConfig(policy=str(trained), rollouts=1, out=str(tmp_path / "out"))
    score_arms([config], workers=1)
    (trained / "README.md").write_text("a card changes nothing")
    score_arms([config], workers=1)
    assert len(jobs) == 1
    (trained / "model.safetensors").write_bytes(b"trained again")
    for _ in range(2):
        with pytest.raises(ContractError, match=r"of this policy and calibration.*resume=false"):
            score_arms([config], workers=1)
    score_arms([dataclasses.replace(config, resume=False)], workers=1)
    assert len(jobs) == 2


def test_a_table_holds_the_scenes_that_were_asked_for_last(tmp_path, rolled_out):
    jobs = rolled_out(lambda *_: True)
    for first, rollouts in ((5, 3), (100, 2), (5, 2)):
        config = ScoreConfig(rollouts=rollouts, first_seed=first, out=str(tmp_path))
        score_arms([config], workers=1)
        (report,) = write_report(config)
        assert [row.seed for row in report.rows] == list(config.seeds)
    assert len(jobs) == 5  # the last two were scored before


def test_two_processes_do_not_score_into_one_folder(tmp_path, rolled_out):
    jobs, config = rolled_out(lambda *_: True), ScoreConfig(rollouts=1, out=str(tmp_path))
    with only_writer(config.folder / ROWS), pytest.raises(ContractError, match="another one too"):
        score_arms([config], workers=1)
    assert not jobs and score_arms([config], workers=1)[0].n == 1


def test_a_slot_the_policy_lacks_is_refused_before_processes_start(tmp_path, rolled_out):
    jobs = rolled_out(lambda *_: True)
    with pytest.raises(ContractError, match="touch0"):
        score(ScoreConfig(swap="nose:left", workers=1, out=str(tmp_path)))
    assert not jobs


@pytest.mark.parametrize(
    "worn, fits", [("uskin", True), ("uskin:1+lag=100", True), ("uskin:2", False)]
)
def test_the_calibration_of_another_unit_is_refused(worn, fits, tmp_path, rolled_out):
    jobs, config = rolled_out(lambda *_: True), stored_config(shipped_checkpoint())
    found = LatentMap(config.tokens_per_slot, config.latent_size)
    folder = Calibration(
        found, config.tokenizer_hash, "", "uskin:1", "tactip:1", 1.0, 0.0, {}
    ).save(tmp_path / "map")
    asked = ScoreConfig(
        right_sensor=worn, right_calibration=str(folder), rollouts=1, workers=1, out=str(tmp_path)
    )
    with (
        nullcontext()
        if fits
        else pytest.raises(ContractError, match=r"one of uskin:2, got one of uskin:1")
    ):
        score(asked)
    assert len(jobs) == fits


def test_two_dask_workers_score_as_one_process_does(tmp_path):
    """An extra: joblib's Dask back-end carries rollouts over a cluster."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is optional")
    plain = ScoreConfig(
        policy="expert", level="easy", rollouts=2, videos=0, out=str(tmp_path / "one")
    )
    one = score_arms([plain], workers=1)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        two = score_arms([dataclasses.replace(plain, out=str(tmp_path / "two"))], workers=2)
    assert [report.as_dict() for report in one] == [report.as_dict() for report in two]


def test_every_script_can_be_scored():
    assert set(score_worker.SCRIPTS) == set(SCRIPTS)


class Watching:
    def __init__(self):
        self.seen = []

    def reset(self, env):
        self.seen = []

    def chunk(self, observation, task):
        self.seen.append(observation)
        return np.zeros((1, 5))


@pytest.fixture(scope="module")
def bank():
    return donated_touch(Rig("easy"), donors=1)


@pytest.mark.parametrize("phase", [0, 2])
def test_shuffled_touch_is_another_scenes_in_the_same_phase(phase, bank, monkeypatch):
    assert set(bank) == {0, 1, 2, 3}
    monkeypatch.setattr(WipeEnv, "phase", phase)
    watching, env = Watching(), WipeEnv("easy")
    observation, _ = env.reset(seed=3)
    shuffled = ShuffledTouch(watching, bank)
    for _ in range(2):  # the same scene gets the same other scene's touch
        shuffled.reset(env)
        shuffled.chunk(observation, "wipe")
        seen = watching.seen[0]
        images = {name: seen["pixels"][name] for name in TACTILE_NAMES}
        assert all(
            i.shape == (480, 640, 3) and set(np.unique(i)) <= {0, 255} for i in images.values()
        )
        packed = {n: np.packbits(image[..., 0] > 0, axis=-1) for n, image in images.items()}
        assert any(
            all(np.array_equal(packed[n], donor[n]) for n in TACTILE_NAMES) for donor in bank[phase]
        )
        assert np.array_equal(seen["pixels"]["front"], observation["pixels"]["front"])
        assert np.array_equal(seen["agent_pos"], observation["agent_pos"])
    if phase == 2:  # pressed on the board there, in free air here
        assert not np.array_equal(images["tactile_left"], observation["pixels"]["tactile_left"])


def test_frozen_touch_stays_as_it_was_half_a_second_into_the_wipe():
    watching = Watching()
    frozen = FrozenTouch(watching)
    for phase, time_s, shown in ((1, 1.0, 1), (2, 1.1, 1), (2, 1.4, 1), (2, 1.6, 0), (3, 2.0, 0)):
        env = SimpleNamespace(phase=phase, trace=SimpleNamespace(time_s=np.array([time_s])))
        if phase == 1:
            frozen.reset(env)
        frozen._env = env
        pixels = {"front": np.full(1, time_s), "tactile_right": np.full(1, time_s)}
        frozen.chunk({"pixels": pixels}, "wipe")
        seen = watching.seen[-1]["pixels"]
        assert seen["front"] == time_s and seen["tactile_right"] == (time_s if shown else 1.4)


def test_unknown_controls_and_controls_of_scripts_are_refused(tmp_path):
    with pytest.raises(ContractError, match="masked"):
        controlled(None, "asleep", WipeEnv("easy"), Rig("easy"))
    with pytest.raises(ContractError, match="Controls are for policies"):
        score_job(0, ScoreConfig(policy="expert", control="masked", out=str(tmp_path)), 1)


def test_a_sensor_that_fails_at_the_first_look_makes_an_aborted_row(tmp_path, caplog):
    config = ScoreConfig(right_sensor="tactip:1+light=0", out=str(tmp_path))
    _, row = score_job(0, config, 10_000)
    assert (row.code, row.seconds, row.residual) == ("a", 0.0, 1.0)
    assert "scene 10000 is aborted: tactip on the right finger" in caplog.text
