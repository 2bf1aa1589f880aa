"""A rig's file as people write it: empty sections, other encodings, LeRobot's cameras; whatever is
wrong is named."""

import subprocess
import sys
from importlib.machinery import ModuleSpec

import pytest
from lerobot.cameras.opencv import OpenCVCameraConfig

from uniforce_robots.recorder import build
from uniforce_robots.recorder.build import read_devices
from uniforce_vtla.errors import ContractError

SCENE = "type: uniforce_scene, source: /dev/video0"
SIZE = "width: 640, height: 480, fps: 30"


@pytest.fixture
def rig(tmp_path):
    return tmp_path / "rig.yaml"


def read(rig, content, *flags):
    rig.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_devices(flags, True, "keyboard", str(rig))


def refused(rig, content, *flags):
    """Return the one line that refuses a file."""
    with pytest.raises(ContractError) as error:
        read(rig, content, *flags)
    said = str(error.value)
    assert "instantiate" not in said and "\n" not in said
    return said


@pytest.mark.parametrize(
    "content",
    [
        "",
        "robot:\n",
        "robot:\n  address: 127.0.0.99\nteleop:\n  # device: /dev/hidraw3\n",
        "robot:\n  cameras:\n  guards:\n",
        # of another one than was asked for
        "robot: {id: null}\nteleop: {type: spacemouse, device: /dev/hidraw3}",
        "\ufeffrobot:\n  address: 127.0.0.98\n",
        "robot: {}".encode("utf-16"),
        '{"robot": {"address": "127.0.0.98"}}',
    ],
)
def test_what_is_left_out_keeps_its_default(rig, content):
    robot, teleop = read(rig, content)
    assert not robot.cameras and robot.guards == type(robot.guards)()
    assert teleop.type == "uniforce_keyboard"


def test_flags_override_the_file(rig):
    content = f"robot: {{guards: {{step_m: 0.03}}, cameras: {{front: {{{SCENE}}}}}}}"
    flags = ("--robot.cameras.front.fps=15", "--robot.guards.low=[0,0,0,0,0]", "--robot.id=a")
    robot, _ = read(rig, content, *flags)
    assert (robot.id, robot.guards.step_m, robot.guards.low) == ("a", 0.03, (0, 0, 0, 0, 0))
    assert robot.cameras["front"].fps == 15


@pytest.mark.parametrize(
    "content, names",
    [
        ("- robot", "rig.yaml"),
        ("robot", "rig.yaml"),
        ("robots: {}", "robots"),
        ("1: 2", "rig.yaml"),
        ("robot: {a: [}", "rig.yaml"),
        ("robot: !!python/object:os.system {}", "rig.yaml"),
        ("robot: " + "[" * 3000, "rig.yaml"),
        ("robot:\n  address: 127.0.0.98 # Größe\n".encode("latin-1"), "rig.yaml"),
        (b"\0\1\2", "rig.yaml"),
        ("robot: [1, 2]", "robot"),
        ("teleop: 5", "teleop"),
        ("teleop: {device: /dev/x}", "device"),
        ("robot: {type: so100}", "so100"),
        ("robot: {address: }", "robot.address"),
        ("robot: {fps: fast}", "robot.fps"),
        ("robot: {guards: 3}", "robot.guards"),
        ("robot: {guards: {low: }}", "robot.guards.low"),
        ("robot: {connect_deadline_s: .inf}", "connect_deadline_s"),
        ("robot: {realtime: maybe}", "realtime"),
        ("robot: {cameras: [front]}", "robot.cameras"),
    ],
)
def test_a_file_that_will_not_do_is_named_in_a_line(rig, content, names):
    assert names in refused(rig, content)


@pytest.mark.parametrize(
    "camera, reason",
    [
        ("", "nothing"),
        ("7", "7"),
        ("[1]", "[1]"),
        ("{source: /dev/video0}", "type"),
        ("{type: [1]}", "uniforce_scene"),
        ("{type: uniforce_scenes}", "uniforce_scene |"),
        (f"{{{SCENE}, fps: null}}", "fps"),
        (f"{{{SCENE}, width: null}}", "width"),
        (f"{{{SCENE}, with: 224}}", "`with`"),
        (f"{{{SCENE}, max_age_ms: null}}", "max_age_ms"),
        (f"{{{SCENE}, max_age_ms: -1}}", "above 0"),
        (f"{{{SCENE}, frozen_after: often}}", "often"),
        ("{type: uniforce_scene}", "source"),
        ("{type: uniforce_tactile, sensor: nose, source: /dev/video0}", "nose"),
        (f"{{type: opencv, {SIZE}}}", "index_or_path"),
        ("{type: opencv, index_or_path: 0}", "width"),
        (f"{{type: opencv, index_or_path: 0, {SIZE}, fourcc: ABCDE}}", "fourcc"),
        (f"{{type: opencv, index_or_path: 0, {SIZE}, rotation: 45}}", "rotation"),
    ],
)
def test_a_camera_that_will_not_do_is_named_with_the_reason(rig, camera, reason):
    said = refused(rig, f"robot:\n  cameras:\n    front: {camera}\n")
    assert "front" in said and reason in said and "null" not in said


@pytest.mark.parametrize(
    "teleop, file, named",
    [
        ("telepathy", "", "uniforce_keyboard"),
        ("keyboard", "no.yaml", "no.yaml"),
        ("keyboard", "/tmp", "/tmp"),
    ],
)
def test_unknown_teleoperators_and_files_that_are_none_are_refused(teleop, file, named):
    with pytest.raises(ContractError, match=named):
        read_devices([], True, teleop, file)


FLAGS = "adress=1 cameras.front=3 cameras.front={ cameras.front.fps= cameras=3 guards=3"


@pytest.mark.parametrize("flag", FLAGS.split())
def test_a_flag_that_will_not_do_is_named(rig, flag):
    assert "robot." in refused(
        rig, f"robot: {{cameras: {{front: {{{SCENE}}}}}}}", f"--robot.{flag}"
    )


STOCK = {
    "opencv": "index_or_path: 0",
    "intelrealsense": "serial_number_or_name: '0123456789'",
    "zmq": "server_address: 127.0.0.1, camera_name: front",
}


@pytest.mark.parametrize("kind", STOCK)
def test_lerobots_cameras_are_understood(rig, kind, monkeypatch):
    content = f"robot: {{cameras: {{front: {{type: {kind}, {STOCK[kind]}, {SIZE}}}}}}}"
    monkeypatch.setattr(build, "find_spec", lambda name: ModuleSpec(name, None))
    assert read(rig, content)[0].cameras["front"].type == kind
    monkeypatch.setattr(build, "find_spec", lambda name: None)
    with pytest.raises(ContractError, match=r"front: expected the package .* pip install 'lerobot"):
        read(rig, content)


def test_lerobots_cameras_are_loaded_when_a_file_names_one(rig):
    """In a process of its own: imports of other tests would register them."""
    rig.write_text(f"robot: {{cameras: {{front: {{type: opencv, index_or_path: 0, {SIZE}}}}}}}")
    code = "import sys; from uniforce_robots.recorder.build import read_devices as read\n"
    code += "assert 'lerobot.cameras.opencv' not in sys.modules\n"
    code += "print(read([], True, 'keyboard', sys.argv[1])[0].cameras['front'])"
    said = subprocess.check_output([sys.executable, "-c", code, rig], text=True)
    assert OpenCVCameraConfig.__name__ in said
