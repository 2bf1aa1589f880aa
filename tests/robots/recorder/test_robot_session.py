"""A whole session on a fake robot: episodes, labels, faults, resume; the same in the scene."""

import io
import os
import signal
import threading
import time
from contextlib import nullcontext
from unittest.mock import Mock

import numpy as np
import pytest
from recording_fakes import FakeRig, Script

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_datasets.cards import read_card
from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import read_source, stored_frames
from uniforce_robots.recorder import disk_guard
from uniforce_robots.recorder.assemble import run_session
from uniforce_robots.recorder.operators import VERDICTS, Command, Event, Phase, Unattended
from uniforce_robots.recorder.session import SessionSettings
from uniforce_robots.recorder.sim_rig import SimRig
from uniforce_robots.recorder.store import StoreSettings, open_recorder
from uniforce_robots.sensors.faults import WrongSensorError
from uniforce_vtla import keys
from uniforce_vtla.errors import ContractError, TeleoperatorError
from uniforce_vtla.terminal import STOPS

WAITING, RUNNING, PAUSED, _ = Phase
PLAIN = {"episodes": 1, "episode_s": 0.5, "prompts": ("wipe",), "unwell_s": 1.0, "late_share": 1.0}


def record(rig, teleop, operator, root, wanted, **more):
    store = StoreSettings(root, "local/test", reserve_MB=1.0)
    return run_session(rig, teleop, operator, store, wanted, open_store=open_recorder, **more)


@pytest.fixture
def fake(tmp_path, monkeypatch):
    return FakeRig(tmp_path / "calibration", monkeypatch)


@pytest.fixture
def root(tmp_path):
    """Where the dataset of a session goes."""
    return tmp_path / "data"


@pytest.fixture
def go(fake, root, teleop):
    """Return a function that runs a session on the fake robot and leaves nothing running."""

    def run(operator=None, out=None, **settings):
        wanted = SessionSettings(**(PLAIN | settings))
        operator = operator or Unattended("success")
        end = record(fake.rig, teleop, operator, root, wanted, out=out)
        assert not fake.robot.is_connected and not teleop.is_connected
        assert not [t.name for t in threading.enumerate() if t.name in ("arm-stream", "hand")]
        return end

    return run


def test_two_episodes_then_one_more(go, root):
    end = go(episodes=2, prompts=("wipe", "clean the board"))
    assert end.exit_code == 0 and [e.label for e in end.endings] == ["success"] * 2
    assert go(episodes=3).message == "3 of 3 episodes"
    dataset = open_dataset(root, return_uint8=True)
    assert dataset.num_episodes == 3 and len(dataset) == 45
    assert {dataset[i]["task"] for i in (0, 15)} == {"wipe", "clean the board"}
    reference = dataset[3][keys.tactile_key("left", reference=True)].numpy()
    assert set(np.unique(reference)) == {0, 255}
    for episode in range(3):
        assert stored_frames(raw_path(root, "left", episode)) == 15
        assert read_card(root, episode)["label"] == "success"


def test_what_a_row_holds(go, root):
    go()
    ticks = column(root, keys.STAMPS)
    assert (np.diff(ticks, axis=1) >= 0).all() and ticks[0, 0] < 0.1
    # how steadily, a busy machine can't say: see docs/recording.md
    assert (np.diff(ticks[:, 0]) > 0).all()
    for source in ("front", "left"):
        age = column(root, keys.age_key(source))
        assert (age >= 0).all() and age.max() < 0.2
        taken = column(root, keys.time_key(source))
        np.testing.assert_allclose(taken + age, ticks[:, 1], atol=1e-4)
        index = column(root, keys.index_key(source))
        assert (np.diff(index) >= 0).all() and index[-1] > 3
    assert np.ptp(column(root, keys.ACTION)[:, 0]) > 0.001, "the sway was stored"
    assert len(column(root, keys.measured_key("wrench"))) == len(ticks)
    widths_m = column(root, keys.measured_key("hand"))[:, 0]
    np.testing.assert_allclose(widths_m, 0.08, atol=1e-6)


def test_an_episode_that_missed_many_ticks_is_aborted_and_does_not_count(teleop, go, root):
    quick = teleop.get_action
    teleop.get_action = lambda: time.sleep(2.5 / 30) or quick()
    console = io.StringIO()
    end = go(out=console, late_share=0.1)
    assert end.exit_code == 3 and "missed" in end.message and "3 times in a row" in end.message
    assert "stored aborted:late" in console.getvalue() and "0/1 episodes" in console.getvalue()
    assert labels(root) == ["aborted:late"] * 3


def column(root, key):
    return read_source(root).columns((key,))[key]


def labels(root):
    starts = [episode.start for episode in read_source(root).episodes]
    outcomes = [keys.OUTCOME_NAMES[code] for code in column(root, keys.OUTCOME)[starts]]
    causes = [keys.ABORT_CAUSES[code] for code in column(root, keys.CAUSE)[starts]]
    return [o if c == "none" else f"{o}:{c}" for o, c in zip(outcomes, causes, strict=True)]


def scripted(*lines):
    """Begin whenever waiting; say or do each line once, when its phase is asked so often."""
    left = list(lines)

    def say(phase, asked):
        said = [Command.GO] * (phase is WAITING)
        if left and left[0][:2] == (phase, asked):
            line = left.pop(0)[2]
            said = [line] if isinstance(line, Command | Event) else line() or said
        return said

    return Script(say)


@pytest.mark.parametrize("command", VERDICTS)
def test_keys_judge_an_episode(command, go, root):
    end = go(scripted((RUNNING, 6, command)), episode_s=30.0)
    assert end.exit_code == 0 and labels(root) == [VERDICTS[command]]
    assert read_source(root).num_frames == 6


BREAKS = {  # what breaks, how, the cause that is stored
    "camera unplugged": ("front", "stop", "camera"),
    "camera silent": ("front", "stall", "stale_camera"),
    "camera frozen": ("front", "freeze", "frozen_camera"),
    "finger silent": ("tactile_left", "stall", "stale_touch"),
    "finger frozen": ("tactile_right", "freeze", "frozen_touch"),
    "reflex": ("arm", "reflex", "robot_reflex"),
    "user stop": ("arm", "user_stopped", "robot_user_stop"),
    "teleoperator": ("teleop", "unplugged", "teleop"),
    "rig": ("rig", "a bug", "other"),
}


def break_it(fake, teleop, what, how):
    if what == "arm":
        fake.arm.mode = how
    elif what == "teleop":
        teleop.error = KeyError(how)
    elif what == "rig":
        fake.rig.observe = {}
    else:
        fake.captures[what].fault = how


@pytest.mark.parametrize("name", BREAKS)
def test_a_fault_ends_the_episode_held_and_labelled(fake, teleop, name, go, root):
    what, how, cause = BREAKS[name]
    breaks = (RUNNING, 6, lambda: break_it(fake, teleop, what, how))
    end = go(scripted(breaks, (WAITING, 0, Command.QUIT)), episode_s=5.0)
    assert end.exit_code == 0 and len(end.endings) == 1, end
    ending = end.endings[0]
    assert ending.label.startswith("aborted:") and cause in ending.label, ending
    assert ending.held_s < 0.5
    assert labels(root) == [ending.label]
    assert cause in read_card(root, 0)["label"]


def test_discard_rerecord_pause_and_notes(teleop, go, root):
    operator = scripted(
        (RUNNING, 3, Command.DISCARD),
        (RUNNING, 4, Command.RERECORD),
        (RUNNING, 8, Event(Command.NOTE, "slow")),  # asked on: no waiting in between
        (RUNNING, 9, Command.GO),
        (PAUSED, 5, Command.GO),
        (RUNNING, 3, Command.SUCCESS),
    )
    end = go(operator, episode_s=30.0)
    assert [e.label for e in end.endings] == ["discard", "rerecord", "success"]
    assert end.endings[2].pauses == 1 and len(teleop.starts) == 4, "three episodes and one going on"
    assert set(column(root, keys.SEED).ravel()) == {1}, "re-recording is of the same scene"
    card = read_card(root, 0)
    assert card["notes"] == ["slow"] and card["prompt"] == "wipe" and card["guards"]["sensor"] == 0
    assert np.diff(column(root, keys.STAMPS)[:, 0]).max() > 5 / 30, "the pause shows"


def test_a_pause_ends_once_the_device_is_at_rest(teleop, go):
    own_start = teleop.start_from

    def start_from(axes):
        own_start(axes)
        if len(teleop.starts) == 2:
            raise TeleoperatorError("let go", "far")

    teleop.start_from = start_from
    operator = scripted(
        (RUNNING, 2, Command.HOLD),
        (PAUSED, 1, Command.HOLD),
        (PAUSED, 2, Command.GO),
        (PAUSED, 4, Command.GO),
        (RUNNING, 2, Command.SUCCESS),
    )
    end = go(operator, episode_s=30.0, drive_between=False)
    assert [e.label for e in end.endings] == ["success"] and len(teleop.starts) == 3


@pytest.mark.parametrize("interruption", ["fault", "hold", "robot"])
def test_between_episodes_steering_goes_on_at_a_persons_word(fake, teleop, interruption, go):
    calls = {}
    out = io.StringIO()
    orders = {10: Command.NOTE, 29: Command.RECOVER, 40: Command.QUIT}
    if interruption == "hold":
        orders[5] = Command.HOLD

    def say(phase, asked):
        calls[asked] = len(teleop.starts), teleop.calls
        if asked == 5:
            teleop.error = KeyError("unplugged") if interruption == "fault" else None
            fake.arm.mode = "reflex" if interruption == "robot" else "idle"
        if asked == 7:
            teleop.error = None  # plugged in again
            fake.arm.mode = "idle"
        return [Event(orders[asked], "early")] if asked in orders else []

    end = go(Script(say), out)
    assert end.exit_code == 0 and not end.endings
    assert calls[5] == (1, 5), "driven"
    assert calls[8] == calls[28], "plugged in again, but nobody said so"
    assert calls[40] == (2, 11)
    assert out.getvalue().count("(v clears it and steers again)") == 1
    assert "not stored: early" in out.getvalue()


@pytest.mark.parametrize("name", ["Open the gripper", "bad_touch"])
def test_nothing_begins_out_of_free_air_nor_from_a_moving_gel(fake, name, go):
    finger = fake.captures["tactile_left"]
    if name == "bad_touch":
        finger.frames = tuple(
            np.roll(frame, 12 * n, axis=1) for n, frame in enumerate(finger.frames)
        )
    else:
        fake.hand.width_m = 0.03
    end = go(unwell_s=0.3)
    assert end.exit_code == 3 and name in end.message and not end.endings


def test_an_open_hand_is_asked_for_again(fake, go):
    fake.hand.width_m = 0.03
    opens = (WAITING, 2, lambda: setattr(fake.hand, "width_m", 0.08))
    operator = scripted(opens, (RUNNING, 3, Command.SUCCESS))
    end = go(operator, drive_between=False, episode_s=30.0)
    assert end.exit_code == 0 and [e.label for e in end.endings] == ["success"]


def test_a_full_disk_stops_at_the_next_tick_and_what_was_saved_stays(monkeypatch, go, root):
    go()
    room = iter([10**12] * 8)
    monkeypatch.setattr(disk_guard, "free_bytes", lambda path: next(room, 10))
    end = go(episodes=2, episode_s=5.0)
    assert end.exit_code == 4 and labels(root) == ["success", "aborted:disk_full"]
    assert end.endings[0].held_s < 0.1
    end = go(episodes=2)
    assert end.exit_code == 4 and not end.endings, "no room for another one"


@pytest.fixture(autouse=True)
def hang_up_counts():
    """Tests that are run under nohup ignore SIGHUP."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    "come", ["INT", "TERM", "HUP", "HUP HUP HUP", "TERM HUP", "INT INT", "HUP TERM INT"]
)
def test_a_stop_from_outside_ends_the_episode_in_order_unless_somebody_insists(
    fake, come, go, root
):
    """Whoever reads what is shown may be gone by then."""
    reader, writer = os.pipe()

    def interrupt():
        os.close(reader)
        for name in come.split():
            signal.raise_signal(signal.Signals[f"SIG{name}"])

    before = [signal.getsignal(number) for number in STOPS]
    insists = len(come.replace("HUP", "").split()) > 1
    with open(writer, "w") as out, pytest.raises(KeyboardInterrupt) if insists else nullcontext():
        end = go(scripted((RUNNING, 5, interrupt)), out=out, episode_s=5.0)
        assert end.exit_code == 130 and labels(root) == ["aborted:interrupt"]
    assert not fake.robot.is_connected and insists is not (root / "data").exists()
    assert [signal.getsignal(number) for number in STOPS] == before


def test_nohup_goes_on_without_its_terminal(go):
    hang_up = (RUNNING, 5, lambda: signal.raise_signal(signal.SIGHUP))
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert go(scripted(hang_up, (RUNNING, 8, Command.SUCCESS))).exit_code == 0
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_terminal_that_takes_its_keyboard_along_is_an_interrupt_too(fake, teleop, go, root):
    breaks = (RUNNING, 5, lambda: setattr(teleop, "error", RuntimeError("hung up")))
    own_hold = fake.rig.hold

    def hold():
        if teleop.error is not None:
            signal.raise_signal(signal.SIGHUP)
        own_hold()

    fake.rig.hold = hold
    assert go(scripted(breaks), episode_s=5.0).exit_code == 130
    assert labels(root) == ["aborted:interrupt"]


def test_a_row_that_the_store_refuses_late_ends_the_session_in_order(monkeypatch, go):
    error = ContractError("state: expected finite numbers")
    monkeypatch.setattr(EpisodeRecorder, "save", Mock(side_effect=error))
    end = go()
    assert end.exit_code == 3 and "finite" in end.message and len(end.endings) == 1


def test_another_sensor_than_configured_is_refused_before_anything_moves(fake, go):
    fake.captures["tactile_left"] = fake.captures["tactile_right"]
    with pytest.raises(WrongSensorError, match="Another sensor answers"):
        go()
    assert not fake.arm.targets and not fake.robot.is_connected


def test_another_setting_of_the_rig_is_refused_before_the_first_episode(fake, go, root):
    """Also what the robot itself says once it is connected."""
    load_kg = [0.7]
    fake.robot.stored_facts = lambda: {"load_kg": load_kg[0]}
    assert go(rig={"robot.gain": 1}).exit_code == 0
    load_kg[0] = 0.9
    with pytest.raises(ContractError, match=r"robot.gain 1 → 2, robot.stored.load_kg 0.7 → 0.9"):
        go(episodes=2, rig={"robot.gain": 2})
    end = go(episodes=2, rig={"robot.gain": 2}, accept_changes=True)
    assert end.exit_code == 0
    first, second = (read_card(root, episode)["settings"] for episode in (0, 1))
    assert first["rig"] == {"robot.gain": 1, "robot.stored.load_kg": 0.7} and not first["changed"]
    assert second["changed"] == {"robot.gain": [1, 2], "robot.stored.load_kg": [0.7, 0.9]}


STEPS = 6


def test_a_scene_is_recorded_like_a_robot(teleop, root):
    rig = SimRig(WipeEnv("easy", max_steps=STEPS), paced=False)
    settings = SessionSettings(episodes=2, episode_s=10.0)
    end = record(rig, teleop, Unattended("success"), root, settings, seed=5)
    assert end.exit_code == 0
    assert [e.label for e in end.endings] == labels(root) == ["failed_grasp"] * 2, "its own verdict"
    assert column(root, keys.SEED).tolist() == [5] * STEPS + [6] * STEPS
    assert not column(root, keys.SUCCESS).any()
    assert len(column(root, keys.truth_wrench_key("left"))) == 2 * STEPS
    moved_m = column(root, keys.ACTION) - column(root, keys.STATE)
    assert np.abs(moved_m[:, 0]).max() > 1e-4
    dataset = open_dataset(root, return_uint8=True)
    env = WipeEnv("easy", max_steps=STEPS)
    observation, _ = env.reset(seed=6)
    first = dataset[STEPS]
    assert first["task"] == env.task
    image = first[keys.tactile_key("left")].permute(1, 2, 0).numpy()
    assert np.array_equal(image, observation["pixels"]["tactile_left"])
