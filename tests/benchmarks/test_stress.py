"""Stress: operators, rollouts, the monitor, and the page."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

from benchmarks.stress import rollouts
from benchmarks.stress.__main__ import CALIBRATED, StressCommand, check_ledger
from benchmarks.stress.__main__ import arms as arms_of
from benchmarks.stress.actors import Arm, play
from benchmarks.stress.disturbed import EXCHANGED, SCENE_OPERATORS, Disturbance, DisturbedEnv
from benchmarks.stress.monitor import summary, watched
from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.page import monitor_row, one_table
from benchmarks.stress.readings import ReadsWorn
from benchmarks.stress.rollouts import (
    cells_of,
    mean_corruption_error,
    near_cliffs,
    of_the_scene,
    repeatability,
    roll,
    summarise,
)
from benchmarks.stress.row import Row
from benchmarks.stress.stock import StockController
from benchmarks.stress.warning import first_event_s, warned
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.episode import STEP_FIELDS, WIPING_PHASE, EpisodeTrace, ScoreLimits
from uniforce_vtla.keys import CAMERAS
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.latent_range import LatentRange

SCENE = range(39_700, 39_701)


@pytest.fixture(scope="module")
def tokenizer() -> Tokenizer:
    return Tokenizer.from_pretrained()


@pytest.fixture(scope="module")
def head() -> ForceHead:
    return ForceHead.from_pretrained()


def test_every_operator_has_five_doses_and_a_sensor_that_can_have_it() -> None:
    for operator in OPERATORS.values():
        assert len(operator.doses) == 5
        away = np.abs(np.array(operator.doses) - operator.benign)
        assert (np.diff(away) > 0).all()  # from mild to severe
        words = [
            worn_with(operator, sensor, operator.doses[0]) for sensor in ("tactip:1", "uskin:2")
        ]
        assert any(words)
        for one in filter(None, words):
            wear(one)
    assert worn_with(OPERATORS["M2 flicker"], "uskin:2", 0.1) is None


def test_the_reading_expert_regulates_by_what_the_head_reads(tokenizer, head) -> None:
    env, expert = (
        WipeEnv("touch", drawn=("right",), right_sensor="uskin:2"),
        ReadsWorn("right", tokenizer, head),
    )
    for _ in walk(env, expert, SCENE[0]):
        pass
    assert env.result().success


def screened(*errors: float) -> list[dict]:
    doses = (OPERATORS["T1 lag"].benign, *OPERATORS["T1 lag"].doses)
    return [
        {"dose": dose, "press_error_N": error} for dose, error in zip(doses, errors, strict=True)
    ]


def test_doses_near_a_cliff_are_rolled_out_and_the_worst_where_there_is_none() -> None:
    steep, flat, refused = (
        screened(0, 0.1, 0.5, -2, 5, 9),
        screened(0, *[0.1] * 5),
        screened(0, *[np.inf] * 5),
    )
    found = near_cliffs({"none": {}, "T1 lag": steep, "T2 stall": flat, "H1 creep": refused})
    assert found == {"T1 lag": [67, 133], "T2 stall": [533], "H1 creep": [533]}
    assert near_cliffs({"none": {}, "T1 lag": steep, "H1 creep": refused}, most=0) == {
        "T1 lag": [133]
    }


def test_the_middle_doses_of_a_scenes_fault_are_rolled_out() -> None:
    assert of_the_scene()["P2 pushed arm"] == [4, 8, 12] and of_the_scene(most=0)[
        "P2 pushed arm"
    ] == [8]


def test_a_calibration_with_the_fault_is_worn_where_there_is_one(tmp_path) -> None:
    faulty = {
        name: {"dose": dose, "press_error_N": 9.0}
        for name, (dose,) in CALIBRATED["calibrated"][1].items()
    }
    screened = {
        sensor: {"none": {}} | {n: [{}, cell] for n, cell in faulty.items()}
        for sensor in ("tactip:1", "uskin:2")
    }
    (tmp_path / "stress_screen.json").write_text(json.dumps({"screened": screened}))
    for name in (
        "tactip-1+gain=1.6",
        "tactip-1-loads",
        "tactip-1-loads+gain=1.3",
        "tactip-1-loads+gain=1.6",
    ):
        (tmp_path / name).mkdir()
    found = {
        arm.name: (arm, doses)
        for arm, doses in arms_of(StressCommand(facts=str(tmp_path), calibrations=str(tmp_path)))
    }
    arm, doses = found["policy on tactip:1, calibrated"]
    assert arm.refitted and doses == {"G2 keener": [1.6]}
    arm, doses = found["policy on tactip:1, weighed"]
    assert arm.calibration.endswith("tactip-1-loads") and doses == {"G2 keener": [1.3, 1.6]}
    assert (
        EXCHANGED in found["policy on tactip:1"][1]
        and EXCHANGED not in found["policy on uskin:2"][1]
    )


def episode(press_N: np.ndarray) -> EpisodeTrace:
    n = len(press_N)
    steps = {name: np.zeros(n) for name in STEP_FIELDS} | {
        "time_s": np.arange(1, n + 1) / 30,
        "press_N": press_N,
    }
    held = {"grip_left_N": np.full(n, 5.0), "grip_right_N": np.full(n, 5.0), "phase": np.ones(n)}
    return EpisodeTrace(**steps | held, rated_depth_mm=(9.0, 9.0))


def test_a_warning_comes_half_a_second_before_what_the_unwatched_twin_does() -> None:
    press_N = np.full(90, 6.0)
    press_N[60] = 20.0
    assert first_event_s(episode(press_N), ScoreLimits()) == pytest.approx(61 / 30, abs=1e-3)
    assert first_event_s(episode(press_N[:60]), ScoreLimits()) is None

    def ended(seed: int, outcome: str, ended_s: float, event_s: float | None) -> Row:
        return replace(row("a", seed, False), outcome=outcome, ended_s=ended_s, event_s=event_s)

    twins = {seed: ended(seed, "success", 9.0, 4.0) for seed in range(4)} | {
        4: ended(4, "success", 9.0, None)
    }
    watched = {
        0: ended(0, "aborted", 3.0, None), 1: ended(1, "aborted", 3.9, None), 2: ended(2, "success", 9.0, None),
        3: ended(3, "success", 9.0, 4.0), 4: ended(4, "aborted", 1.0, None),
    }  # fmt: skip
    assert warned(watched, twins) == {"failures": 4, "warned": 1, "averted": 1}


def row(cell: str, seed: int, clean: bool) -> Row:
    return Row(cell, seed, clean, "success" if clean else "residual", 0.9, False, False)


def test_the_first_dose_that_loses_more_than_the_margin_breaks() -> None:
    cells = cells_of(Arm("me", "uskin:2"), {"T1 lag": [33, 533], "M2 flicker": [0.1]})
    assert [cell.name for cell in cells] == [
        "me",
        "me, T1 lag 0",
        "me, T1 lag 33",
        "me, T1 lag 533",
    ]  # taxels: no flicker
    rows = {cell.name: {seed: row(cell.name, seed, True) for seed in range(40)} for cell in cells}
    rows["me, T1 lag 533"] |= {seed: row("", seed, False) for seed in range(10)}
    found = summarise(cells, rows)
    assert (found[""]["n"], found[""]["clean"]) == (40, 40)
    lag = found["T1 lag"]
    assert (lag["clean"], lag["benign"], lag["breaking_dose"]) == ([40, 30], 40, 533)
    few = {
        name: {seed: one for seed, one in found.items() if seed < 20}
        for name, found in rows.items()
    }
    assert summarise(cells, few)["T1 lag"]["breaking_dose"] is None  # too few scenes to tell
    assert not summarise(cells, few)["T1 lag"]["judged"] and lag["judged"]
    none = summarise(cells, {name: {} for name in rows})["T1 lag"]  # an arm that plays later
    assert (none["n"], none["lower_bound"]) == ([0, 0], [-1.0, -1.0])


def test_benign_doses_act_in_a_few_scenes_and_end_as_without_the_fault(
    tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(rollouts, "play", lambda *given: row(given[5], given[6], given[6] != 1))
    cells = cells_of(Arm("me", "uskin:2"), {"T1 lag": [533]})
    rows = roll(cells, "touch", range(6), 1, tmp_path / "rows.jsonl", benign=3)
    assert {name: len(found) for name, found in rows.items()} == {
        "me": 6,
        "me, T1 lag 0": 3,
        "me, T1 lag 533": 6,
    }
    lag = summarise(cells, rows)["T1 lag"]
    assert (lag["benign"], lag["benign_n"], lag["benign_alike"]) == (2, 3, True)
    rows["me, T1 lag 0"][0] = row("", 0, False)
    assert not summarise(cells, rows)["T1 lag"]["benign_alike"]


def test_a_policy_of_lerobots_own_acts_in_the_scene(tmp_path) -> None:
    pictures = {
        f"observation.images.{name}": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))
        for name in CAMERAS
    }
    config = ACTConfig(
        input_features=pictures | {"observation.state": PolicyFeature(FeatureType.STATE, (5,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (5,))},
        pretrained_backbone_weights=None, dim_model=16, n_heads=2, dim_feedforward=16, n_encoder_layers=1,
        use_vae=False, chunk_size=4, n_action_steps=2, device="cpu",
    )  # fmt: skip
    for part in (ACTPolicy(config), *make_pre_post_processors(config)):
        part.save_pretrained(tmp_path)
    env, controller = DisturbedEnv(Disturbance(), "touch", drawn=()), StockController(str(tmp_path))
    observation, _ = env.reset(seed=39_700)
    controller.reset(env)
    action = controller.chunk(observation, env.task)
    assert action.shape == (1, 5) and np.isfinite(action).all()


def test_two_halves_of_the_scenes_agree_or_not() -> None:
    cells = cells_of(Arm("me", "uskin:2"), {"T1 lag": [33, 533]})
    rows = {cell.name: {seed: row(cell.name, seed, True) for seed in range(20)} for cell in cells}
    rows["me, T1 lag 533"] |= {seed: row("", seed, False) for seed in range(0, 20, 2)}
    assert repeatability(cells, rows) == {"cells": 3, "agree": 2}  # the benign dose is none of them


def test_two_runs_of_one_truth_agree_in_nineteen_of_twenty_cells() -> None:
    rng, cells = np.random.default_rng(0), cells_of(Arm("me", "uskin:2"), {"T1 lag": [33]})
    runs = [
        {c.name: {seed: row("", seed, rng.random() < 0.7) for seed in range(24)} for c in cells}
        for _ in range(400)
    ]
    agree = sum(repeatability(cells, rows)["agree"] for rows in runs)
    assert 0.92 < agree / 800 < 0.98


def test_episodes_are_kept(tmp_path) -> None:
    cells = cells_of(Arm("expert", acts="expert"), {})
    path = tmp_path / "rows.jsonl"
    kept = row("expert", 7, True)
    path.write_text(json.dumps(asdict(kept)) + "\n")
    assert roll(cells, "touch", range(7, 8), 1, path) == {"expert": {7: kept}}
    path.write_text(path.read_text() + '{"cell": "exp')  # killed while it wrote
    found = roll(cells, "touch", range(7, 9), 1, path)
    assert found["expert"][7] == kept and roll(cells, "touch", range(7, 9), 1, path) == found


def arms() -> dict:
    def found(clean: list[int], benign: int) -> dict:
        return {
            "unit": "ms",
            "doses": [33, 67],
            "clean": clean,
            "n": [40, 40],
            "benign": benign,
            "breaking_dose": None,
        }

    usual = {"n": 40, "clean": 40}
    return {
        "policy on tactip:1": {
            "": usual,
            "T1 lag": found([40, 30], 40),
            "P2 pushed arm": found([20, 10], 40),
        },
        "expert reads tactip:1": {"": usual, "T1 lag": found([40, 40], 40)},
        "expert": {"": usual, "P2 pushed arm": found([39, 38], 40)},
        "policy without monitor": {"": usual, "T1 lag": found([9, 8], 40)},
        "policy without touch": {"": {"n": 40, "clean": 20}, "P2 pushed arm": found([8, 0], 20)},
    }


def test_the_table_puts_the_right_expert_beside_each_operator(tmp_path) -> None:
    table = one_table(arms(), {}, {"n": 40, "clean": 1})
    operators = table["operators"]
    assert operators["T1 lag"]["expert"] == [40, 40] and operators["P2 pushed arm"]["expert"] == [
        39,
        38,
    ]
    assert "policy without touch" not in operators["T1 lag"]
    assert operators["T1 lag"]["policy without monitor"] == {"clean": [9, 8], "n": [40, 40]}
    # 10 of 80 failed where the policy without touch fails 20 of 40; 50 of 80 where it fails 72 of 80
    assert table["mce"] == pytest.approx((0.125 / 0.5 + 0.625 / 0.9) / 2, abs=1e-3)
    assert mean_corruption_error({"": {}}, {}) is None
    rolled = {name: found for name, found in arms().items() if name != "policy without touch"}
    assert one_table(rolled, {}, {"n": 40, "clean": 20})["mce"] == pytest.approx(
        (0.125 + 0.625) / 0.5 / 2, abs=1e-3
    )


def test_the_monitor_is_judged_by_what_costs_twenty_points() -> None:
    cells = [{"dose": 33, "auroc": 0.5}, {"dose": 67, "auroc": 0.9}, {"dose": 133, "auroc": 1.0}]
    clean = {"wipes": 40, "hours": 0.5, "false_alarms": 1}
    noticed = {
        "operators": {"T1 lag": {"cells": cells}, "H1 creep": {"cells": cells}},
        "clean": clean,
    }
    watched = {name: found for name, found in arms().items() if name != "policy without monitor"}
    found = monitor_row(watched, noticed, {"T1 lag 67": {"failures": 3}})
    assert found["auroc"] == {"T1 lag 67": 0.9} and found["auroc_mild"] == {"T1 lag 33": 0.5}
    assert found["false_alarms_per_hour"] == 2 and found["warned"]["T1 lag 67"]["failures"] == 3
    # unwatched it costs more
    assert set(monitor_row(arms(), noticed, {})["auroc"]) == {"T1 lag 33", "T1 lag 67"}


def test_every_disturbance_changes_its_episode_and_its_benign_dose_does_not() -> None:
    def felt(disturbance: Disturbance) -> list:
        env = DisturbedEnv(disturbance, "touch", drawn=())
        env.start(39_700)
        for _ in range(70):  # past the first push
            env.advance(np.array([0.45, -0.17, 0.05, 0.0, 0.05]))
        return [env.state.tolist(), env.task, repr(env.scene)]

    usual = felt(Disturbance())
    for name, operator in SCENE_OPERATORS.items():
        assert felt(operator.disturb(operator.benign)) == usual or name.startswith("X1"), name
        assert felt(operator.disturb(operator.doses[0])) != usual or name.startswith("X1"), name


def test_a_unit_is_exchanged_once_the_board_is_wiped() -> None:
    env, expert = (
        DisturbedEnv(Disturbance(exchanged="tactip:4"), "touch", drawn=("right",)),
        WipeExpert(),
    )
    references = []
    for step, _ in enumerate(walk(env, expert, 39_700)):
        if step % 20 == 0:
            references.append((env.phase, env.marker_pair("right")[0].copy()))
    wiping = [image for phase, image in references if phase == WIPING_PHASE]
    assert all(
        (image == references[0][1]).all() for phase, image in references if phase < WIPING_PHASE
    )
    assert (wiping[-1] != references[0][1]).any()


def test_a_refused_reference_is_an_aborted_episode() -> None:
    arm = Arm("expert reads tactip:1", acts="reads")
    found = play(arm, "touch", "tactip:1+flicker=0.9", "M2 flicker", 0.9, "cell", 39_700, 39_700)
    assert found.outcome == "aborted" and found.cell == "cell"


def test_a_monitors_alarm_is_timed_and_clean_wipes_are_told_from_faulty_ones() -> None:
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


def test_a_ledger_of_another_policy_is_refused(tmp_path) -> None:
    expert, shipped = Arm("expert", acts="expert"), Arm("policy", policies=("shipped",))
    for _ in range(2):
        check_ledger(tmp_path, [expert, shipped])
    check_ledger(tmp_path, [expert])
    with pytest.raises(ContractError, match=r"other ones' of \['policy'\]"):
        check_ledger(tmp_path, [replace(shipped, policies=("seed0",))])
