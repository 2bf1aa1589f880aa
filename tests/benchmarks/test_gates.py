"""Gates of a level: what each script believes, that a run goes on where it stopped, and what is
said of the level."""

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from benchmarks.gates.__main__ import GATES, Gate, main
from benchmarks.gates.blind import BlindScript, BlindSettings
from benchmarks.gates.fitting import STYLES
from benchmarks.gates.observer import train_observer
from benchmarks.gates.readings import EverySixth, Frozen, ReadingExpert, scaled
from benchmarks.gates.scripts import LagLaw, LagMeter
from benchmarks.scene_blocks import BLOCKS
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert, draw_scene
from lerobot_env_uniforce_wiping.episodes import run_script
from lerobot_env_uniforce_wiping.expert import Contact

SEED = 4


def test_no_scene_is_in_two_blocks():
    for (one, a), (other, b) in combinations(BLOCKS.items(), 2):
        assert a.stop <= b.start or b.stop <= a.start, f"{one} and {other} share scenes"


@pytest.mark.parametrize("style", sorted(STYLES))
def test_without_touch_the_press_depends_on_the_hidden_stiffness(style, monkeypatch):
    build, grips_N = STYLES[style]
    nominal = draw_scene(SEED, "touch")
    nominal = replace(nominal, gripper_gain=1.0, board_height_m=nominal.level.layout.board_height_m)
    presses = []
    for stiffness in (0.7, 1.7):
        scene = replace(nominal, stiffness_scale=stiffness)
        monkeypatch.setattr(
            "lerobot_env_uniforce_wiping.env.draw_scene", lambda *_, scene=scene: scene
        )
        script = BlindScript(BlindSettings(5.0, grips_N[1]), build)
        presses.append(run_script(WipeEnv(level="touch"), script, SEED).metrics["press_mean_N"])
    assert presses[1] > 1.4 * presses[0] > 0


def test_touch_that_stops_changing_or_misreads_does_not_wipe_this_board():
    env = WipeEnv(level="touch")

    def clean(script):
        return sum(run_script(env, script, seed).clean for seed in range(5))

    assert clean(WipeExpert()) >= 4
    assert clean(ReadingExpert(Frozen)) <= 1
    assert clean(ReadingExpert(lambda: scaled(0.7))) <= 1


def test_refreshed_touch_stands_still_between_looks():
    rule = EverySixth()
    read = [rule(Contact(float(k), 0.0), None, "wipe").grip_N for k in range(13)]
    assert read == [0] * 6 + [6] * 6 + [12]


def test_the_lag_of_a_steady_motion_is_found_and_says_the_stiffness():
    meter = LagMeter()
    assert meter.lag_s is None
    for k in range(40):
        meter(0.001 * k, 0.001 * k - 0.003)  # 30 mm/s, 3 mm behind
    assert meter.lag_s == pytest.approx(0.1)
    law = LagLaw(a=float(np.log(0.1)), b=-1.0)  # nominal · 0.1 s / lag
    assert law.stiffness(800.0, 0.1) == pytest.approx(800.0)
    assert law.stiffness(800.0, 0.2) == pytest.approx(400.0)


def test_an_observer_learns_a_press_that_its_inputs_hold_and_no_other():
    rng = np.random.default_rng(0)
    seen = rng.standard_normal((40, 60, 11)).astype(np.float32)
    press = 6 + 2 * seen[..., 2]
    shuffled = rng.permutation(press.ravel()).reshape(press.shape)
    _, known = train_observer(list(zip(seen, press, strict=True)))
    _, unknown = train_observer(list(zip(seen, shuffled, strict=True)))
    assert known > 0.9 and unknown < 0.1


def test_a_gate_holds_on_its_own_side_of_its_bar():
    passes, fails = Gate(None, at_least=0.9), Gate(None, at_most=0.2)
    assert passes.holds(0.9) and not passes.holds(0.89)
    assert fails.holds(0.2) and not fails.holds(0.21)


def test_a_run_scores_every_script_and_a_second_one_goes_on(tmp_path, capsys):
    small = ["level=easy", "learn_from=3", "sweep_on=1", "learn_seed=30000", "workers=2"]
    given = [*small, f"work={tmp_path / 'work'}", f"out={tmp_path / 'gates.json'}"]
    assert main([*given, "episodes=1"]) == 0
    rows = next((tmp_path / "work").glob("easy_*.jsonl"))
    first = rows.read_text()
    assert main([*given, "episodes=1"]) == 0 and rows.read_text() == first
    written = json.loads((tmp_path / "gates.json").read_text())
    assert set(written["must_pass"] | written["must_fail"]) == set(GATES)
    assert written["must_pass"]["expert"]["n"] == 1
    assert "DOES NOT HOLD" in capsys.readouterr().out or written["all_hold"]
