"""Stress: operators of the screen, and what is read of a faulty sensor."""

import numpy as np
import pytest

from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.readings import ReadsWorn, read_scenes
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
