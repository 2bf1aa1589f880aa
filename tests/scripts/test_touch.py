"""``uniforce touch``: the live view, its outputs, and its checks, against stand-ins."""

import json
import re
import subprocess
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from contact_samples import faces

from uniforce_cli.touch import TouchConfig, main
from uniforce_cli.touch_checks import advice, check_angle, check_references, quarter_response
from uniforce_cli.touch_view import OUTPUTS, TouchView, as_text, panel, save_panel
from uniforce_datasets.film_references import FilmReference
from uniforce_robots.sensors import UniforceUskin, UniforceUskinConfig
from uniforce_robots.sensors.config_uniforce import TURNS, Orientation
from uniforce_robots.standins.process import StandIn
from uniforce_robots.standins.scene import Scene, frame_cycle, taxel_cycle
from uniforce_vtla.contact import ContactOptions, TactileSimulator
from uniforce_vtla.contracts import QUARTERS
from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers import Canonicalizer


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


def test_without_rerun_its_output_says_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ContractError, match="rerun"):
        OUTPUTS["rerun"]()


def test_rerun_receives_everything(monkeypatch):
    logged = {}
    fake = SimpleNamespace(
        init=lambda name: None,
        connect_grpc=lambda: None,
        log=lambda path, value: logged.update({path: value}),
        Image=lambda image: image.shape,
        Scalars=lambda value: value,
    )
    monkeypatch.setitem(sys.modules, "rerun", fake)
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda command, **how: started.append(command))
    OUTPUTS["rerun"]()(view())
    # its own default is every interface
    assert started[0][1:] == ["-m", "rerun", "--bind", "127.0.0.1"]
    assert (
        logged["markers"] == (480, 640) and logged["force_N/z"] == 7.25 and logged["age_ms"] == 3.2
    )


def test_live_view_of_a_stand_in(tmp_path, capsys):
    with StandIn("slcan", "rate_hz=100", "rest_s=3", "press_s=2") as stand_in:
        save = tmp_path / "touch.png"
        given = ["seconds=3", "refresh_hz=5", f"save={save}"]
        code = main(["sensor=uskin", f"source={stand_in.address}", *given])
    out = capsys.readouterr().out
    assert code == 0 and save.is_file(), out
    assert "taking the reference" in out and re.search(r"force x y z +[-+]\d", out)


def test_live_view_of_a_camera_stand_in(capsys):
    with StandIn("mjpeg", "sensor=gelsight", "rate_hz=10", "press_s=0") as stand_in:
        assert (
            main(["sensor=gelsight", f"source={stand_in.address}", "seconds=1", "head=none"]) == 0
        )
    out = capsys.readouterr().out
    assert "mean grey" in out and "no head" in out


def test_a_missing_sensor_is_named(capsys, refuses):
    assert main(["sensor=uskin", "source=/dev/absent"]) == 2
    out = capsys.readouterr().err
    assert "touch: uskin on the left finger" in out and "/dev/absent" in out
    refuses(main, ["source="], "source=standin")
    assert (
        main(["sensor=paxini", "source=/dev/absent"]) == 2
        and "No driver" in capsys.readouterr().err
    )


@pytest.fixture
def patch():
    """The port of a patch that is pressed in its top-left quarter after a second of free air, 100 scans per second."""
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


class Still:
    """A finger, as far as ``quarter_response`` needs one."""

    def __init__(self, sensor, reference):
        self.canonicalizer = Canonicalizer(sensor)
        self.canonicalizer.set_reference(reference)
        self.reference_raw = reference.astype(np.int64) if reference.ndim == 2 else reference
        self.marker_image = self.canonicalizer.marker_image

    def reference_image(self):
        return np.repeat(self.marker_image(self.reference_raw)[..., None], 3, axis=2)


@pytest.mark.parametrize("sensor", ["uskin", "tactip", "gelsight"])
@pytest.mark.parametrize("where", QUARTERS)
def test_the_pressed_quarter_is_found(sensor, where):
    scene = Scene(where=where, hold=True)
    if sensor == "uskin":
        free, pressed = taxel_cycle(Scene(press_s=0), 2)[0], taxel_cycle(scene, 2)[0]
    else:
        free, pressed = (
            frame_cycle(sensor, Scene(press_s=0), 1)[0],
            frame_cycle(sensor, scene, 1)[0],
        )
    finger = Still(sensor, free)
    response = quarter_response(finger, pressed)
    assert QUARTERS[int(response.argmax())] == where and response.max() >= 1
    assert quarter_response(finger, free).max() < 0.5


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("flip", [False, True])
def test_the_advice_is_the_orientation_that_mends_it(turn, flip):
    """A patch mounted in any of eight ways: measured quarters come from really turned counts."""
    seen = {}
    for asked in QUARTERS:
        upright = taxel_cycle(Scene(where=asked, hold=True), 2)[0]
        mounted = _inverse(turn, flip, upright)
        free = _inverse(turn, flip, taxel_cycle(Scene(press_s=0), 2)[0])
        z = (mounted[:, 2].astype(int) - free[:, 2]).reshape(4, 4)[::-1]
        quarter = [z[y, x].sum() for y in (slice(2), slice(2, 4)) for x in (slice(2), slice(2, 4))]
        seen[asked] = QUARTERS[int(np.argmax(quarter))]
    said = advice(seen, 0, False)
    assert f"rotation_deg={turn} flip={str(flip).lower()}" in said


def _inverse(turn, flip, counts):
    return Orientation(0, flip).of_counts(Orientation(-turn % 360).of_counts(counts))


def test_advice_asks_for_what_it_needs():
    assert "all four" in advice({"top-left": "top-right"}, 0, False)
    assert "no turn" in advice({"top-left": "top-left", "top-right": "top-left"}, 0, False)
    assert "rotation_deg=0" in advice({"top-left": "top-right"}, 90, False)


class Dragged:
    """A TacTip mounted at an angle whose skin is dragged towards its tip and let go."""

    def __init__(self, mounted_deg, set_deg):
        self.config = TouchConfig("tactip", rotation_deg=set_deg)
        simulator = TactileSimulator("tactip", options=ContactOptions().quiet())
        pull = np.array([0, 1, 2, 3, 2, 0], np.float32)
        force_N = np.column_stack([0 * pull, -pull, np.full(6, 5.0)])
        frames = simulator.raw_frames(faces(force_N, side_mm=20.0))
        upright = Orientation(set_deg)
        mounted = [
            Orientation(-mounted_deg % 360).of_frame(f)
            for f in (simulator.raw_reference(), *frames)
        ]
        self.frames = [upright.of_frame(frame) for frame in mounted]
        self.canonicalizer = Canonicalizer("tactip")
        self.canonicalizer.set_reference(self.frames[0])
        self.marker_image = self.canonicalizer.marker_image

    def reference_image(self):
        return np.repeat(self.marker_image(self.frames[0])[..., None], 3, axis=2)

    def next_touch(self, index, _):
        return SimpleNamespace(
            index=index + 1, raw=self.frames[min(index + 2, len(self.frames) - 1)]
        )


@pytest.mark.parametrize("mounted, rotation", [(0, 0), (18, 18), (339, 0), (18, 0)])
def test_a_drag_tells_the_angle_on_the_mount(mounted, rotation, capsys):
    code = check_angle(Dragged(mounted, rotation), 20.0)
    out = capsys.readouterr().out
    assert code == int(mounted != rotation) and ("angle agrees" in out) == (mounted == rotation)
    if code:
        assert abs(float(out.split("rotation_deg=")[1]) - mounted) <= 4


def test_a_finger_without_a_stand_in_name_is_made_from_its_source():
    from uniforce_cli.touch import make_finger

    links = {"ws://10.0.0.5:5000": "server", "/dev/ttyUSB0": "slcan"}
    for source, link in links.items():
        finger = make_finger(TouchConfig(sensor="uskin"), source)
        assert isinstance(finger, UniforceUskin) and isinstance(finger.config, UniforceUskinConfig)
        assert finger.config.link == link
    camera = make_finger(TouchConfig(sensor="tactip", lock_camera=False), "http://127.0.0.1:1/")
    assert camera.config.capture_width is None and camera.config.exposure_100us is None


def reference(film, **where):
    return FilmReference(film, film.partition("/")[0], 4, {}, **where)


def test_references_of_films_are_listed_and_a_film_without_one_fails(tmp_path, capsys):
    own = reference("mug/1.avi", of="mug/1.avi", frame=10, off_px=0.21, pad=0)
    lent = reference("ball/1.avi", of="mug/1.avi", frame=10, off_px=0.21, pad=0)
    assert check_references([own, lent], str(tmp_path / "found.json")) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "mug/1.avi: frame 10, pad 0, 0.21 px off"
    assert lines[1] == "ball/1.avi: BORROWED from mug/1.avi, frame 10, pad 0, 0.21 px off"
    stored = json.loads((tmp_path / "found.json").read_text())["films"]
    assert [one["borrowed"] for one in stored] == [False, True] and stored[1]["of"] == "mug/1.avi"
    assert (
        check_references(
            [own, reference("lemon/1.avi", why="lemon/1.avi: expected a free frame, got none.")]
        )
        == 1
    )
    assert "1 with a free frame, 0 borrow one, 1 have none" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words", [["films={0}"], ["check=reference"], ["check=reference", "films={0}", "source=x"]]
)
def test_films_are_looked_at_without_a_device(words, tmp_path, capsys, refuses):
    assert main(["sensor=gelsight", *(word.format(tmp_path) for word in words)]) == 2
    assert "check=reference films=FOLDER alone" in capsys.readouterr().err
    refuses(
        main, ["sensor=gelsight", "check=reference", f"films={tmp_path}"], "folder of one session"
    )
