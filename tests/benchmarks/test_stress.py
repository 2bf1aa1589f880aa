"""Stress: operators and the monitor, faults of the curves, what acts and what is kept."""

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from benchmarks.stress import __main__ as stress
from benchmarks.stress import actors
from benchmarks.stress.disturbed import Disturbance, DisturbedEnv
from benchmarks.stress.faults import FAULTS, SCALES
from benchmarks.stress.monitor import summary, watched
from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.readings import ReadsWorn
from benchmarks.stress.row import Row
from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.latent_range import LatentRange

SCENE = 39_700


def test_every_operator_has_five_doses_and_a_sensor_that_can_have_it():
    for operator in OPERATORS.values():
        mildest = operator.doses[0]
        assert len(operator.doses) == 5
        away = np.abs(np.array(operator.doses) - operator.benign)
        assert (np.diff(away) > 0).all()  # from mild to severe
        words = [worn_with(operator, sensor, mildest) for sensor in ("tactip:1", "uskin:2")]
        assert any(words)
        for one in filter(None, words):
            wear(one)
    assert worn_with(OPERATORS["M2 flicker"], "uskin:2", 0.1) is None


def test_the_reading_expert_regulates_by_what_the_head_reads():
    env = WipeEnv("touch", drawn=("right",), right_sensor="uskin:2")
    expert = ReadsWorn("right", Tokenizer.from_pretrained(), ForceHead.from_pretrained())
    for _ in walk(env, expert, SCENE):
        pass
    assert env.result().success


def test_every_fault_has_four_doses_and_the_one_that_changes_nothing():
    def felt(disturbance):
        env = DisturbedEnv(disturbance, "touch", drawn=())
        env.start(SCENE)
        for _ in range(70):  # past the first push
            env.advance(np.array([0.45, -0.17, 0.05, 0.0, 0.05]))
        return [env.state.tolist(), repr(env.scene)]

    usual = felt(Disturbance())
    for name, fault in FAULTS.items():
        assert len(fault.doses) == 4
        assert fault.none not in fault.doses
        for dose in (fault.none, *fault.doses):
            wear(actors.SENSOR + fault.words(dose))
        assert felt(fault.scene(fault.none)) == usual, name
        if not fault.sensor:
            assert felt(fault.scene(fault.doses[0])) != usual, name
    assert set(SCALES) <= {name for name, fault in FAULTS.items() if fault.sensor}


def test_a_refused_reference_is_an_aborted_episode(tmp_path, monkeypatch):
    monkeypatch.setattr(actors, "SENSOR", "tactip:1+flicker=0.9")
    found = actors.play("cell", "expert that reads it", "", "", 0.0, SCENE, tmp_path)
    assert (found.cell, found.outcome) == ("cell", "aborted")


def test_a_weighed_actor_wears_the_gain_of_its_faulty_sensor(tmp_path, monkeypatch):
    folder = Mock(side_effect=InterruptedError)
    monkeypatch.setattr(actors, "calibration_folder", folder)
    for fault, words in (("stiffness", "tactip:1+stiffness=0.7"), ("late pictures", "tactip:1")):
        with pytest.raises(InterruptedError):
            actors.play("cell", "policy, sensor weighed", "seed0", fault, 0.7, SCENE, tmp_path)
        assert folder.call_args.args[:2] == (words, "tool")


def test_curves_are_rolled_out_scene_by_scene_and_go_on(tmp_path, monkeypatch):
    played = []

    def play(name, actor, policy, fault, dose, seed, work):
        played.append((seed, Path(policy).name))
        return Row(name, seed, dose < 6, "success", 0.9, False, False)

    monkeypatch.setattr(stress, "play", play)
    monkeypatch.setattr(stress, "content_of", lambda policy: Path(policy).name)
    for seed in (0, 1):
        (tmp_path / f"latent/seed{seed}").mkdir(parents=True)
    out = tmp_path / "curves.json"
    given = [f"checkpoints={tmp_path}", f"work={tmp_path / 'work'}", f"out={out}", "workers=1"]
    given += ["only=pushed arm", "actors=policy", "scenes=2"]
    for _ in range(2):  # what the ledger holds isn't played again
        assert stress.main(given) == 0
        assert len(played) == 2 * 5
    assert {policy for seed, policy in played if seed == played[0][0]} == {"seed0"}
    found = json.loads(out.read_text())["actors"]["policy"]["pushed arm"]
    assert found == {"doses": [0, 2, 4, 6, 8], "clean": [2, 2, 2, 0, 0], "n": [2] * 5}
    assert out.with_suffix(".png").stat().st_size > 5000


def test_a_ledger_of_other_policies_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(stress, "content_of", lambda policy: (Path(policy) / "a").read_text())
    config = stress.StressCommand(checkpoints=str(tmp_path), work=str(tmp_path / "work"))
    with pytest.raises(CheckpointError, match="latent/seed0"):
        stress.policies_of(config)
    (tmp_path / "latent/seed0").mkdir(parents=True)
    (tmp_path / "work").mkdir()
    (tmp_path / "latent/seed0/a").write_text("one")
    for _ in range(2):
        stress.policies_of(config)
    (tmp_path / "latent/seed0/a").write_text("another")
    with pytest.raises(ContractError, match="of other ones"):
        stress.policies_of(config)


def test_a_monitors_alarm_is_timed_and_clean_wipes_are_told_from_faulty_ones():
    usual = LatentRange("tactip", "abc", 6, free_limit=1.0, run_limit=2.0)
    calm, odd = np.full(60, 0.5), np.full(60, 0.5)
    odd[30:] = 3.0  # looks of 1/15 s
    clean, faulty = (watched(distances, usual, 4.0, refused=False) for distances in (calm, odd))
    assert clean.score == pytest.approx(0.5) and clean.alarm_s == np.inf
    assert faulty.run == pytest.approx(1.5) and 30 / 15 < faulty.alarm_s < 40 / 15
    in_free_air = watched(odd[::-1], usual, 4.0, refused=False)
    assert in_free_air.free == pytest.approx(3.0) and in_free_air.alarm_s == pytest.approx(0.2)
    refused = watched(calm[:3], usual, 0.2, refused=True)
    found = summary([faulty, refused], [clean, clean])
    assert (found["auroc"], found["noticed"], found["refused"]) == (1.0, 2, 1)
