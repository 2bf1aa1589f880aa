"""``uniforce record`` itself: the scene steered by a teleoperator, and what it refuses."""

import pytest
import recording_fakes  # noqa: F401  registers the teleoperator recording_test

from uniforce_cli.record import main
from uniforce_datasets.cards import read_card
from uniforce_datasets.lossless import open_dataset

QUICK = ["teleop=recording_test", "level=easy", "operator=unattended"]
QUICK += ["episode_s=0.2", "real_time=false"]


@pytest.mark.thorough
def test_a_scene_by_hand_and_its_resume(tmp_path, capsys, refuses):
    root = tmp_path / "data"
    own = [*QUICK, f"teleop.calibration_dir={tmp_path}", "teleop.id=a", "teleop.width_m=0.07"]
    own += ["reserve_MB=1", "right_sensor=tactip:drawing"]
    left = "left_sensor=gelsight:drawing"
    assert main([*own, left, f"root={root}", "episodes=1"]) == 0
    assert "1 of 1 episodes" in capsys.readouterr().out
    assert main([*own, left, f"resume={root}", "episodes=2", "prompts=[tidy up]"]) == 0
    assert open_dataset(root).num_episodes == 2 and read_card(root, 1)["prompt"] == "tidy up"
    assert read_card(root, 1)["settings"]["rig"]["teleop.width_m"] == 0.07
    refuses(
        main,
        [*own, f"root={root}", "episodes=3", "left_sensor=uskin"],
        "scene.left_sensor 'gelsight:drawing' → 'uskin'",
    )


@pytest.mark.parametrize(
    "words, reason",
    [
        ("robot=moon", "sim | franka"),
        ("robot=franka", "works on a robot"),
        ("robot=franka teleop=recording_test", "instruction"),
        ("teleop=telepathy", "recording_test"),
        ("teleop=recording_test operator=cat", "keys | unattended"),
        ("teleop=recording_test operator=unattended verdict=great", "great"),
        ("teleop=recording_test teleop.speed=1", "speed"),
        ("resume=/nowhere", "recorded dataset"),
        ("episodes=0", "episodes"),
        ("teleop=recording_test episode_s=0", "episode_s"),
        ("teleop=recording_test late_share=nan", "late_share"),
        ("teleop=recording_test late_share=2", "late_share"),
        ("rig=nosuch", "rig: expected a file"),
        ("robot.foo=1", "got --robot.foo=1"),
        ("teleop=recording_test robot.foo=1", "got --robot.foo=1"),
        ("episode_s=9 prompts=[tidy]", "prompts, episode_s"),
        ("teleop=recording_test keep_failures=false", "keep_failures"),
        ("robot=franka teleop=recording_test prompts=[tidy] level=easy", "level"),
        ("robot=franka teleop=recording_test prompts=[tidy] left_sensor=gelsight", "left_sensor"),
        ("teleop=recording_test verdict=success", "got verdict"),
        ("teleop=recording_test operator=unattended drive_between=false", "got drive_between"),
    ],
)
def test_what_cannot_be_is_refused_with_a_reason(words, reason, tmp_path, refuses):
    home = [f"teleop.calibration_dir={tmp_path}", "teleop.id=a"]
    refuses(main, [*words.split(), *home, f"root={tmp_path / 'data'}"], reason)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("root", ["", ".", "/proc/nothing", "{file}", "{file}/below", "{full}"])
@pytest.mark.parametrize("words", [["level=easy"], QUICK])
def test_a_root_that_cannot_be_ends_before_the_first_episode(
    words, root, tmp_path, capsys, monkeypatch
):
    file = tmp_path / "file"
    full = tmp_path / "full"
    file.write_text("mine")
    full.mkdir()
    (full / "letter.txt").write_text("mine")
    monkeypatch.chdir(full)
    own = [f"teleop.calibration_dir={tmp_path}", "teleop.id=a"] if words == QUICK else []
    assert main([*words, *own, f"root={root.format(file=file, full=full)}", "episodes=1"]) == 2
    said = capsys.readouterr()
    assert "folder" in said.err and "Traceback" not in said.err
    assert file.read_text() == "mine"
    assert [path.name for path in full.iterdir() if path.name[0] != "."] == ["letter.txt"]
