"""``uniforce touch``: the live view, its outputs, and its checks, against stand-ins."""

import re
import subprocess
import sys
from functools import partial
from types import SimpleNamespace
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest
from contact_samples import StillFinger, faces

from uniforce_cli import touch, touch_view
from uniforce_cli.touch import TouchConfig, main, make_finger
from uniforce_cli.touch_checks import advice, check_angle, quarter_response
from uniforce_cli.touch_view import OUTPUTS, TouchView, as_text, panel, save_panel
from uniforce_robots.sensors import UniforceUskin, UniforceUskinConfig
from uniforce_robots.sensors.config_uniforce import TURNS, Orientation
from uniforce_robots.standins.process import StandIn
from uniforce_robots.standins.scene import Scene, frame_cycle, taxel_cycle
from uniforce_vtla.contact import ContactOptions, TactileSimulator
from uniforce_vtla.contracts import QUARTERS
from uniforce_vtla.errors import ContractError


def view(taxels=True):
    raw = np.zeros((16, 3), np.int64) if taxels else np.zeros((480, 640, 3), np.uint8)
    if taxels:
        raw[12, 2] = 4321  # the last row of taxels is at the top of the pad
    norms = np.zeros((14, 14), np.float32)
    norms[:2, :2] = 3.0
    force_N = np.array([0.5, -1.0, 7.25], np.float32)
    pictures = raw, np.zeros((480, 640), np.uint8), norms
    return TouchView("uskin on the left finger", *pictures, force_N, 3.2, 120.0, 1)


def test_text_holds_the_numbers_and_the_map():
    text = as_text(view())
    assert "120.0 Hz" in text and "3.2 ms" in text and "lost 1" in text and "+7.25 N" in text
    lines = text.splitlines()
    assert lines[2].startswith("|@@") and "@" not in lines[4]
    assert "4321" in lines[3]  # the top row


@pytest.mark.parametrize("taxels", [True, False])
def test_the_panel_shows_all_three(taxels, tmp_path):
    picture = panel(view(taxels))
    assert picture.shape == (480, 640 + 640 + 480, 3)
    saved = cv2.imread(str(save_panel(view(taxels), str(tmp_path / "sub" / "touch.png"))))
    assert np.array_equal(saved, picture)
    with pytest.raises(ContractError, match=r"\.png"):
        save_panel(view(taxels), str(tmp_path / "touch.xyz"))


def test_rerun_receives_everything(monkeypatch):
    rerun = MagicMock(Image=np.shape, Scalars=float)
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    monkeypatch.setattr(subprocess, "Popen", started := MagicMock())
    OUTPUTS["rerun"]()(view())
    # its own default is every interface
    assert started.call_args.args[0][1:] == ["-m", "rerun", "--bind", "127.0.0.1"]
    logged = dict(call.args for call in rerun.log.call_args_list)
    assert logged["markers"] == (480, 640)
    assert logged["force_N/z"] == 7.25 and logged["age_ms"] == 3.2


def test_live_view_of_a_stand_in(tmp_path, capsys):
    with StandIn("slcan", "rate_hz=100", "rest_s=3", "press_s=2") as stand_in:
        given = ["seconds=3", "refresh_hz=5", f"save={tmp_path / 'touch.png'}"]
        code = main(["sensor=uskin", f"source={stand_in.address}", *given])
    out = capsys.readouterr().out
    assert code == 0 and (tmp_path / "touch.png").is_file(), out
    assert "taking the reference" in out and re.search(r"force x y z +[-+]\d", out)


def test_ctrl_c_keeps_the_last_picture(monkeypatch, tmp_path):
    def shown():
        yield "a view"
        raise KeyboardInterrupt

    saved = []
    monkeypatch.setattr(touch_view, "views", lambda *_: shown())
    monkeypatch.setattr(touch_view, "OUTPUTS", {"terminal": lambda: lambda view: None})
    monkeypatch.setattr(touch_view, "save_panel", lambda view, path: saved.append(view))
    finger = MagicMock()
    monkeypatch.setattr(touch, "opened", lambda config: finger)
    words = ["sensor=uskin", "source=standin", "head=none", f"save={tmp_path / 'last.png'}"]
    assert main([*words, "refresh_hz=1000"]) == 0
    assert saved == ["a view"]


def test_live_view_of_a_camera_stand_in(capsys):
    with StandIn("mjpeg", "sensor=gelsight", "rate_hz=10", "press_s=0") as stand_in:
        words = ["sensor=gelsight", f"source={stand_in.address}", "seconds=1", "head=none"]
        assert main(words) == 0
    out = capsys.readouterr().out
    assert "mean grey" in out and "no head" in out


@pytest.mark.parametrize(
    "words, said",
    [
        ("sensor=uskin source=/dev/absent", "touch: uskin on the left finger"),
        ("sensor=uskin source=/dev/absent", "/dev/absent"),
        ("source=", "source=standin"),
        ("sensor=paxini source=/dev/absent", "No driver"),
    ],
)
def test_a_missing_sensor_is_named(words, said, refuses):
    refuses(main, words.split(), said)


@pytest.fixture
def patch():
    """The port of a patch that is pressed in its top-left quarter after a second of free air, 100
    scans per second."""
    with StandIn("slcan", "rate_hz=100", "where=top-left") as stand_in:
        yield stand_in.address


def test_rate_check(patch, capsys):
    assert main(["sensor=uskin", f"source={patch}", "check=rate", "seconds=1"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"rate \d+\.\d Hz over \d+ samples, lost 0, bad 0", out) and "idle loop" in out


@pytest.mark.parametrize("rotation, code", [(0, 0), (90, 1)])
def test_orientation_check(patch, rotation, code, capsys):
    options = ["check=orientation", "quarters=top-left", "seconds=60", f"rotation_deg={rotation}"]
    assert main(["sensor=uskin", f"source={patch}", *options]) == code
    out = capsys.readouterr().out
    assert ("as asked" if code == 0 else "NOT as asked") in out and "taxel" in out


FREE = Scene(press_s=0)


@pytest.mark.parametrize("sensor", ["uskin", "tactip", "gelsight"])
@pytest.mark.parametrize("where", QUARTERS)
def test_the_pressed_quarter_is_found(sensor, where):
    cycle = taxel_cycle if sensor == "uskin" else partial(frame_cycle, sensor)
    free, pressed = cycle(FREE, 1)[0], cycle(Scene(where=where, hold=True), 1)[0]
    finger = StillFinger(sensor, free)
    response = quarter_response(finger, pressed)
    assert QUARTERS[int(response.argmax())] == where and response.max() >= 1
    assert quarter_response(finger, free).max() < 0.5


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("flip", [False, True])
def test_the_advice_is_the_orientation_that_mends_it(turn, flip):
    """A patch mounted in any of eight ways: measured quarters come from really turned counts."""

    def mounted(scene):
        turned = Orientation(-turn % 360).of_counts(taxel_cycle(scene, 1)[0])
        return Orientation(0, flip).of_counts(turned)

    finger, seen = StillFinger("uskin", mounted(FREE)), {}
    for asked in QUARTERS:
        response = quarter_response(finger, mounted(Scene(where=asked, hold=True)))
        seen[asked] = QUARTERS[int(response.argmax())]
    said = advice(seen, 0, False)
    assert f"rotation_deg={turn} flip={str(flip).lower()}" in said


def test_advice_asks_for_what_it_needs():
    assert "all four" in advice({"top-left": "top-right"}, 0, False)
    assert "no turn" in advice({"top-left": "top-left", "top-right": "top-left"}, 0, False)
    assert "rotation_deg=0" in advice({"top-left": "top-right"}, 90, False)


class Dragged(StillFinger):
    """A TacTip mounted at an angle whose skin is dragged towards its tip and let go."""

    def __init__(self, mounted_deg, set_deg):
        self.config = TouchConfig("tactip", rotation_deg=set_deg)
        mounted, upright = Orientation(-mounted_deg % 360), Orientation(set_deg)
        simulator = TactileSimulator("tactip", options=ContactOptions().quiet())
        pull = np.array([0, 1, 2, 3, 2, 0], np.float32)
        force_N = np.column_stack([0 * pull, -pull, np.full(6, 5.0)])
        frames = simulator.raw_reference(), *simulator.raw_frames(faces(force_N, side_mm=20.0))
        reference, *self.frames = (upright.of_frame(mounted.of_frame(frame)) for frame in frames)
        super().__init__("tactip", reference)

    def next_touch(self, index, _):
        return SimpleNamespace(index=index + 1, raw=self.frames[min(index + 1, 5)])


@pytest.mark.parametrize("mounted, rotation", [(0, 0), (18, 18), (339, 0), (18, 0)])
def test_a_drag_tells_the_angle_on_the_mount(mounted, rotation, capsys):
    code = check_angle(Dragged(mounted, rotation), 20.0)
    out = capsys.readouterr().out
    assert code == int(mounted != rotation) and ("angle agrees" in out) == (mounted == rotation)
    if code:
        assert abs(float(out.split("rotation_deg=")[1]) - mounted) <= 4


def test_a_finger_without_a_stand_in_name_is_made_from_its_source():
    links = {"ws://10.0.0.5:5000": "server", "/dev/ttyUSB0": "slcan"}
    for source, link in links.items():
        finger = make_finger(TouchConfig(sensor="uskin"), source)
        assert isinstance(finger, UniforceUskin) and isinstance(finger.config, UniforceUskinConfig)
        assert finger.config.link == link
    camera = make_finger(TouchConfig(sensor="tactip", lock_camera=False), "http://127.0.0.1:1/")
    assert camera.config.capture_width is None and camera.config.exposure_100us is None
