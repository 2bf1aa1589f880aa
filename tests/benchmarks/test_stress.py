"""Stress: operators of the screen, and what is read of a faulty sensor."""

import numpy as np
import pytest

from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.readings import ReadsWorn, read_scenes
from benchmarks.stress.rollouts import Arm, cells_of, near_cliffs, roll_readers, summarise
from benchmarks.stress.screen import against, screen_cell
from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contact.worn import wear
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

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
        words = [worn_with(operator, sensor, operator.doses[0]) for sensor in ("tactip:1", "uskin:2")]
        assert any(words)
        for one in filter(None, words):
            wear(one)
    assert worn_with(OPERATORS["M2 flicker"], "uskin:2", 0.1) is None


def test_a_duller_sensor_is_read_as_less_press_and_a_benign_dose_as_the_same(tokenizer, head) -> None:
    def cell(words: str) -> dict:
        return screen_cell("touch", words, SCENE, tokenizer, head)

    usual, benign, dull = (cell(f"uskin:2{fault}") for fault in ("", "+gain=1", "+gain=0.55"))
    assert usual == benign and usual["refused_share"] == 0 and usual["press_slope"] > 0.5
    assert against(benign, usual) == 0 and against(dull, usual) < -1
    assert against({"refused_share": 1.0}, usual) == np.inf


def test_frames_that_are_refused_are_counted(tokenizer) -> None:
    found = read_scenes("touch", "right", "tactip:1+lost=0.5", SCENE, tokenizer)
    assert found.refused > 0 and len(found.latent) == 0


def test_the_reading_expert_regulates_by_what_the_head_reads(tokenizer, head) -> None:
    env, expert = WipeEnv("touch", drawn=("right",), right_sensor="uskin:2"), ReadsWorn("right", tokenizer, head)
    for _ in walk(env, expert, SCENE[0]):
        pass
    assert env.result().success


def screened(*errors: float) -> list[dict]:
    doses = (OPERATORS["T1 lag"].benign, *OPERATORS["T1 lag"].doses)
    return [{"dose": dose, "press_error_N": error} for dose, error in zip(doses, errors, strict=True)]


def test_doses_near_a_cliff_are_rolled_out_and_the_worst_where_there_is_none() -> None:
    steep, flat, refused = screened(0, 0.1, 0.5, -2, 5, 9), screened(0, *[0.1] * 5), screened(0, *[np.inf] * 5)
    found = near_cliffs({"none": {}, "T1 lag": steep, "T2 stall": flat, "H1 creep": refused})
    assert found == {"T1 lag": [67, 133], "T2 stall": [533], "H1 creep": [533]}


def test_the_first_dose_that_loses_more_than_the_margin_breaks() -> None:
    cells = cells_of(Arm("me", "uskin:2"), {"T1 lag": [33, 533], "M2 flicker": [0.1]})
    assert [cell.name for cell in cells] == [
        "me",
        "me, T1 lag 0",
        "me, T1 lag 33",
        "me, T1 lag 533",
    ]  # taxels: no flicker
    scenes = range(40)
    clean = {cell.name: dict.fromkeys(scenes, True) for cell in cells}
    clean["me, T1 lag 533"] |= dict.fromkeys(range(10), False)
    found = summarise(cells, clean)
    assert found[""] == {"n": 40, "clean": 40}
    row = found["T1 lag"]
    assert (row["clean"], row["benign"], row["breaking_dose"]) == ([40, 30], 40, 533)


def test_episodes_of_the_reading_expert_are_kept(tmp_path) -> None:
    cells = cells_of(Arm("reads", "uskin:2"), {})
    path = tmp_path / "rows.jsonl"
    path.write_text('{"cell": "reads", "seed": 7, "clean": true}\n')
    assert roll_readers(cells, "touch", range(7, 8), 1, path) == {"reads": {7: True}}
