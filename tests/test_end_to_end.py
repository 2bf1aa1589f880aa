"""The whole line in miniature: record, view, train, evaluate with LeRobot's command, score with a
swap."""

import json
import shutil
import sys
from dataclasses import replace

import pytest
from lerobot.scripts import lerobot_eval
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_env_uniforce_wiping import draw_scene
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_cli.estimate import ScoreRecordingConfig, score_recording
from uniforce_cli.estimate import main as score_recording_main
from uniforce_cli.lerobot_training import train
from uniforce_cli.record import RecordConfig, record
from uniforce_cli.score import ScoreConfig, score
from uniforce_cli.view import ViewConfig, make_view
from uniforce_vtla.errors import ContractError

pytestmark = pytest.mark.timeout(600)
TINY = """
    policy=pi05_uniforce policy.size=tiny policy.device=cpu
    policy.tiny.width=64 policy.tiny.depth=2 policy.tiny.mlp_dim=32
"""
RUN = "batch_size=2 num_workers=0 steps=2 save_freq=2"
EVALUATE = """
    lerobot-eval --policy.device=cpu --env.type=uniforce_wiping --env.level=touch
    --eval.n_episodes=1 --eval.batch_size=1 --eval.use_async_envs=false
"""


@pytest.fixture(scope="module")
def checkpoint(drawn_demo, tmp_path_factory):
    """A policy trained for two steps on one recorded demo, through the same commands a user
    types."""
    folder = tmp_path_factory.mktemp("line")
    make_view(ViewConfig(roots=str(drawn_demo), out=str(folder / "view"), keep_failures=True))
    data = ["dataset.repo_id=local/view", f"dataset.root={folder / 'view'}"]
    train([*TINY.split(), *data, *RUN.split(), f"output_dir={folder / 'train'}"])
    return folder / "train" / "checkpoints" / "last" / "pretrained_model"


@pytest.mark.parametrize(
    "left, swap",
    [("uskin", "touch0:left"), pytest.param("gelsight", "", marks=pytest.mark.thorough)],
)
def test_scores_with_the_trained_and_a_swapped_sensor(checkpoint, tmp_path, left, swap):
    once = {"rollouts": 1, "workers": 1, "out": str(tmp_path)}
    (row,) = score(ScoreConfig(str(checkpoint), "e2e", left_sensor=left, swap=swap, **once)).rows
    assert row.outcome in ("success", "residual", "failed_grasp")
    assert len(list(tmp_path.glob("*/seed_10000.mp4"))) == 1


@pytest.mark.thorough
def test_lerobot_eval_agrees_with_our_score(tmp_path, monkeypatch):
    """The shipped policy wipes the board of the first scene in both commands."""
    (row,) = score(ScoreConfig(rollouts=1, workers=1, videos=0, out=str(tmp_path / "score"))).rows
    assert row.outcome == "success"
    scene = [f"--policy.path={shipped_checkpoint()}", f"--seed={row.seed}"]
    words = [*EVALUATE.split(), *scene, f"--output_dir={tmp_path / 'eval'}"]
    monkeypatch.setattr(sys, "argv", words)
    register_third_party_plugins()
    lerobot_eval.main()
    (info,) = json.loads((tmp_path / "eval" / "eval_info.json").read_text())["per_task"]
    assert info["metrics"]["successes"] == [True]


def test_a_dataset_that_is_full_says_that_nothing_was_recorded(drawn_demo, tmp_path):
    demos = shutil.copytree(drawn_demo, tmp_path / "demos")
    settings = RecordConfig(episodes=1, level="easy", root=str(demos), left_sensor="uskin:drawing")
    changed = r"scene\.left_sensor 'gelsight:drawing' → 'uskin:drawing'"
    with pytest.raises(ContractError, match=changed):
        record(settings)
    end = record(replace(settings, settings_changed="accept"))
    assert end.exit_code == 0 and end.message.startswith(f"nothing new, {demos} holds 1 or more")


def test_a_recording_is_scored_from_its_fingers_alone(drawn_demo, tmp_path):
    """Marker images → newtons → events, and true forces beside them because this recording is
    simulated."""
    friction = draw_scene(3, "easy").pad_friction
    config = ScoreRecordingConfig(
        root=str(drawn_demo),
        pad_friction=",".join(map(str, friction)),
        board_corners="10,10,300,12,310,200,8,190",
        out=str(tmp_path),
    )
    row = score_recording(config)["episodes"][0]
    assert row["press_mae_N"] < 1.5 < row["with_true_forces"]["press_max_N"]
    assert bool(row["slippage"]) == bool(row["with_true_forces"]["slippage"])
    assert not row["lost"] and {"residual", "not_judged"} & set(row["residual"])


@pytest.mark.parametrize("friction", ["", "0.6", "a,b", "0,0.5"])
def test_a_recording_without_known_friction_is_refused(friction, drawn_demo, tmp_path, refuses):
    words = [f"root={drawn_demo}", f"pad_friction={friction}", f"out={tmp_path}"]
    refuses(score_recording_main, words, "pad_friction")
