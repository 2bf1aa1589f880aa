"""Disk guard, steering, operators, beat, live view, faults' names, devices of a command line."""

import io
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest
from fci_client import wait_until
from lerobot.teleoperators import Teleoperator
from robot_fakes import refused

from uniforce_datasets.features import dataset_features
from uniforce_robots.recorder import disk_guard
from uniforce_robots.recorder.build import read_devices, teleoperator_names
from uniforce_robots.recorder.disk_guard import DiskGuard
from uniforce_robots.recorder.faults import DeviceError, cause_of, named
from uniforce_robots.recorder.operators import NOTE_S, Command, Event, KeyOperator, LiveView, Phase
from uniforce_robots.recorder.rig import FingerTouch, Observation, Picture
from uniforce_robots.recorder.robot_rig import GarbageWatch
from uniforce_robots.recorder.steering import Steering
from uniforce_robots.recorder.ticker import Ticker
from uniforce_robots.sensors.faults import LostSensorError
from uniforce_robots.teleop.keyboard import TerminalKeys
from uniforce_vtla import errors
from uniforce_vtla.errors import ContractError
from uniforce_vtla.keys import ABORT_CAUSES, AXES

MB = 10**6


@pytest.fixture
def guard(tmp_path, monkeypatch):
    def make(free_MB):
        monkeypatch.setattr(disk_guard, "free_bytes", lambda path: int(free_MB * MB))
        return DiskGuard(tmp_path, dataset_features(), 0, 100)

    return make


def test_an_episode_needs_room_and_a_reserve(guard):
    assert "GB free" in guard(9000).before_episode(900, 0)
    with pytest.raises(errors.DiskFullError, match="reserve"):
        guard(101).before_episode(900, 0)
    guard(101).check()
    with pytest.raises(errors.DiskFullError, match="100 MB free"):
        guard(99).check()


def test_a_disk_that_is_gone_is_named(guard, monkeypatch):
    gone = MagicMock(side_effect=OSError(5, "Input/output error"))
    monkeypatch.setattr(DiskGuard, "estimate_MB", gone)
    with pytest.raises(errors.DatasetError, match="Was it unplugged"):
        guard(9000).before_episode(900, 100)


def test_what_was_recorded_is_the_best_estimate(tmp_path, guard):
    (tmp_path / "video.mp4").write_bytes(b"0" * 3 * MB)
    assert guard(9000).estimate_MB(200, 100) == pytest.approx(6.0)
    assert 5 < guard(9000).estimate_MB(900, 0) < 100


def device_fault(kind, device, error):
    with pytest.raises(DeviceError, match=device) as caught, named(kind, device):
        raise error
    return caught.value


def test_every_fault_has_a_name_that_datasets_know():
    """Those that a session can't be brought to: the rest is seen there."""
    faults = {
        "lost_camera": device_fault("camera", "front", LostSensorError("x")),
        "bad_touch": device_fault("touch", "tactile_left", errors.SensorError("x")),
        "robot_other": errors.RobotError("x", "none of ours"),
        "dropped_frame": errors.DroppedFrameError("x"),
        "storage": errors.DatasetError("x"),
    }
    assert list(map(cause_of, faults.values())) == list(faults)
    assert set(faults) <= set(ABORT_CAUSES) and len(set(ABORT_CAUSES)) == len(ABORT_CAUSES)


def test_a_teleoperator_of_other_axes_is_refused(teleop):
    teleop.action_features = {"joint_1.pos": float}
    with pytest.raises(errors.ContractError, match=r"x\.pos"):
        Steering(teleop)


ZERO = np.zeros(5)


NO_NUMBER = MagicMock(__float__=Mock(side_effect=ZeroDivisionError))
RETURNS = (
    *(None, "text", {}, [1.0] * 5),
    *[dict.fromkeys(AXES, v) for v in (None, "left", np.nan, [1, 2], NO_NUMBER)],
)


@pytest.mark.parametrize(
    "method", ["connect", "start_from", "send_feedback", "get_action", "disconnect"]
)
@pytest.mark.parametrize(
    "kind", [RuntimeError, KeyError, AttributeError, AssertionError, errors.SensorError]
)
def test_a_teleoperator_may_raise_anything(teleop, method, kind, caplog):
    teleop.feedback_features = teleop.action_features
    setattr(teleop, method, Mock(side_effect=kind("device said nothing")))
    steering = Steering(teleop)
    calls = {"connect": steering.connect, "start_from": lambda: steering.start_from(ZERO)}
    if method != "disconnect":
        with pytest.raises(errors.TeleoperatorError, match=r"recording_test.*device said nothing"):
            calls.get(method, lambda: steering.target(ZERO))()
    teleop.is_connected = True
    steering.close()  # the robot must be seen to
    assert ("said nothing" in caplog.text) == (method == "disconnect")


@pytest.mark.parametrize("action", RETURNS, ids=repr)
def test_a_teleoperator_may_return_anything(teleop, action):
    teleop.get_action = lambda: action
    with pytest.raises(errors.TeleoperatorError, match="recording_test"):
        Steering(teleop).target(ZERO)


@pytest.mark.parametrize("axis, far", [("x.pos", 0.08), ("yaw.pos", 0.5), ("width.pos", 0.04)])
def test_a_leader_of_anybodys_starts_where_the_robot_is(axis, far):
    """Else the robot would go to it through whatever is there."""
    leader = Mock(Teleoperator, feedback_features={}, action_features=AXES)
    leader.name = "leader"
    leader.get_action.return_value = dict.fromkeys(AXES, 0.0) | {axis: far}
    with refused("far", errors.TeleoperatorError, "Bring them together"):
        Steering(leader).start_from(ZERO)


def test_nobody_catches_the_end_of_the_program(teleop):
    teleop.error = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        Steering(teleop).target(ZERO)


def seen(force_N):
    image = np.zeros((4, 4), np.uint8)
    cameras = {"front": Picture(image, 0, 0.95)}
    fingers = {"left": FingerTouch(image, 0, 0.98, image)}
    force = np.array([0, 0, force_N])
    return Observation(1.0, np.full(5, 0.04), cameras, fingers, force_N=force)


def test_the_line_shows_force_against_its_limit():
    out = io.StringIO()
    lines = {}
    view = LiveView(out)
    for force in (3.0, 12.0, 16.0, 1.0):
        view.show(seen(force), 30)
        lines[force] = view.line(seen(force), 30)
    assert "!" not in lines[3.0] and "! " in lines[12.0] and "!!" in lines[16.0]
    for shown in ("peak 16.0 of 15", "oldest front 50 ms", "1.0 s"):
        assert shown in lines[1.0]
    view.begin("next")
    assert view.peak_N == 0
    assert out.getvalue() == "next\n", "without a terminal only lines that stay are written"


def test_the_mode_stands_on_the_screen():
    out = Mock()
    out.isatty.return_value = True
    view = LiveView(out)
    for phase, note, shown in (
        (Phase.PAUSED, None, ["paused"]),
        (Phase.PAUSED, "slip", ["note (Enter ends it, Escape drops it): slip_"]),
        (Phase.PAUSED, "slip", []),
        (Phase.WAITING, None, ["waiting"]),
    ):
        out.write.reset_mock()
        view.show_note(phase, note)
        assert [call.args[0].split("\x1b[K")[1] for call in out.write.mock_calls] == shown
    assert view.line(seen(1.0), 30).startswith("running")
    out.write.side_effect = OSError
    view.say("nobody reads it")
    view.show(seen(1.0), 30)


def test_every_teleoperator_can_be_named():
    """Ours need no settings; one of LeRobot's, where loaded, may say which it needs."""
    names = teleoperator_names()
    assert "recording_test" in names
    for name, registered in names.items():
        try:
            assert read_devices([], False, name)[1].type == registered
        except errors.ContractError as error:
            assert not registered.startswith("uniforce_") and "required field" in str(error)


def test_a_little_garbage_is_borne_and_much_is_not():
    watch = GarbageWatch("tactile_left")
    for step in range(300):
        watch.look(step / 30, step // 8)  # four a second
    with pytest.raises(errors.SensorError, match="bad pieces"):
        for step in range(30):
            watch.look(10 + step / 30, 38 + step)


@pytest.fixture
def person():
    keys = TerminalKeys({"w": (0, 1)}, lambda: keys.now_s)
    keys.now_s = 0.0
    operator = KeyOperator(keys, ["slow", "slipped"])
    operator.keys = keys
    return operator


def typed(operator, *pressed, phase=Phase.RUNNING):
    for key in pressed:
        operator.keys.press(key)
    return operator.poll(phase)


def test_keys_mean_commands_and_unknown_ones_nothing(person):
    events = typed(person, "space", "w", "up", "Y", "esc")
    assert [event.command for event in events] == [Command.GO, Command.SUCCESS, Command.HOLD]
    assert typed(person, "2", "3") == [Event(Command.NOTE, "slipped")]
    assert person.is_attended and not typed(person)


HELD = Event(Command.HOLD)


@pytest.mark.parametrize("phase", Phase)
def test_a_note_holds_the_arm_and_may_hold_command_keys(person, phase):
    person.poll(phase)
    assert typed(person, "T", "Y", "w", phase=phase) == [HELD] and person.note == "Yw"
    assert not typed(person, "space", "z", "backspace", "q", "left", phase=Phase.PAUSED)
    noted = [Event(Command.NOTE, "Yw q"), Event(Command.QUIT)]
    assert typed(person, "enter", "Q", phase=Phase.PAUSED) == noted
    assert typed(person, "t", "enter") == [HELD], "an empty note is none"
    assert typed(person, "t", "a", "esc", "x") == [HELD, HELD, Event(Command.DISCARD)]
    assert person.note is None


@pytest.mark.parametrize(
    "phase, later_s", [(Phase.PAUSED, 2 * NOTE_S), (Phase.JUDGING, 0.0), (Phase.RUNNING, 0.0)]
)
def test_no_note_swallows_commands_for_ever(person, phase, later_s):
    typed(person, "t", "a")
    assert not person.poll(Phase.PAUSED)
    person.keys.now_s = later_s
    assert person.poll(phase) == [Event(Command.NOTE, "a")] and person.note is None
    assert typed(person, "w", "space", phase=Phase.PAUSED) == [Event(Command.GO)]
    assert person.keys.rates()[0] == 1


def test_no_terminal_is_refused(monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ContractError, match="operator=unattended"):
        KeyOperator().start()


def test_a_real_terminal(terminal):
    operator = KeyOperator()
    operator.start()
    terminal(b"y q")
    said = []
    wait_until(lambda: len(said) == 3 or said.extend(operator.poll(Phase.RUNNING)), 30.0)
    operator.stop()
    operator.stop()
    assert [event.command for event in said] == [Command.SUCCESS, Command.GO, Command.QUIT]


class Clock:
    now_s = 100.0

    def __init__(self):
        self.slept = []

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now_s += seconds


def ticker(paced=True):
    clock = Clock()
    return clock, Ticker(10.0, paced, lambda: clock.now_s, clock.sleep)


def test_deadlines_are_absolute():
    clock, beat = ticker()
    for work_s in (0.03, 0.08, 0.0, 0.05):
        beat.wait()
        clock.now_s += work_s
    assert clock.slept == pytest.approx([0.07, 0.02, 0.1]), "the work before is made up for"
    assert beat.stats.mean_hz == pytest.approx(10.0)
    assert beat.stats.jitter_max_ms == pytest.approx(0, abs=1e-6)


def test_what_is_late_and_what_is_missed():
    clock, beat = ticker()
    assert beat.stats.late_share == beat.stats.mean_hz == 0
    beat.wait()
    clock.now_s += 0.13
    assert beat.wait() == pytest.approx(0.03)
    clock.now_s += 0.29
    assert beat.wait() == pytest.approx(0.22), "due at .2, now .42"
    stats = beat.stats
    assert (stats.ticks, stats.missed, stats.late_share) == (3, 2, 0.4)
    assert stats.jitter_max_ms == pytest.approx(220)
    assert beat.wait() == 0 and clock.now_s == pytest.approx(100.5), "back on the grid"


def test_a_pause_does_not_count():
    clock, beat = ticker()
    beat.wait()
    beat.wait()
    clock.now_s += 7.0
    beat.resume()
    beat.wait()
    assert beat.stats.mean_hz == pytest.approx(10.0) and beat.stats.missed == 0


def test_a_scene_does_not_wait():
    clock, beat = ticker(paced=False)
    for _ in range(3):
        beat.wait()
        clock.now_s += 1.0
    assert not clock.slept and beat.stats.missed == 0 and beat.stats.jitter_max_ms == 0
    assert beat.stats.as_dict()["mean_hz"] == 1.0
