"""LeRobot's own commands, each by the very line that docs/lerobot_commands.md shows."""

import importlib
import importlib.util
import json
import re
import shlex
import signal
import socket
import sys
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from safetensors.torch import load_file

from uniforce_datasets.synthetic import record_synthetic
from uniforce_robots.franka import limits
from uniforce_robots.franka.robot import UniforceFranka
from uniforce_robots.sensors import config_uniforce
from uniforce_robots.standins.fci.process import StandIn as ArmStandIn
from uniforce_robots.standins.process import StandIn
from uniforce_vtla.keys import AXES, TACTILE_KEYS

pytestmark = pytest.mark.timeout(600)
ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "lerobot_commands.md").read_text()
COMMANDS = ("record", "edit-dataset", "dataset-viz", "train", "eval", "rollout")
CHECKPOINT = Path("outputs/train/checkpoints/last/pretrained_model")
# a machine that runs tests stalls longer than a robot's may
PATIENT = """\
  stream: {stale_s: 30.0, state_age_s: 30.0}
  gripper: {reading_age_s: 30.0}
"""
CLIENT = importlib.util.find_spec("franky")
has_client = pytest.mark.skipif(CLIENT is None, reason="the Franka's client isn't installed")


def fenced(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def line_of(command):
    (line,) = (code for code in fenced("bash") if code.startswith(f"lerobot-{command} "))
    return line.replace("\\\n", " ")


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def at_free_places():
    """Return a function: put free addresses and ports in place of the page's."""
    port, other = free_port(), free_port()
    places = {"127.0.0.2": f"127.{port % 250 + 1}.{port // 250}.2", "8101": port, "8102": other}
    return lambda text: re.sub(r"127\.0\.0\.2|810[12]", lambda named: str(places[named[0]]), text)


@pytest.fixture(scope="module")
def run(tmp_path_factory, at_free_places):
    """Run a command's line of the page in a folder that holds the page's files."""
    folder = tmp_path_factory.mktemp("commands")
    rig = at_free_places(fenced("yaml")[0])
    rig = rig.replace("capture_width", "max_age_ms: 30000, connect_ms: 60000, capture_width")
    (folder / "rig.yaml").write_text(rig + PATIENT)
    (folder / "policies").symlink_to(ROOT / "policies")
    (folder / "my_teleop").mkdir()
    (folder / "my_teleop" / "__init__.py").write_text(fenced("python")[0])

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        stream = limits.HARD_LIMITS["StreamSettings"]
        for settings, name in (
            (config_uniforce.HARD_LIMITS, "max_age_ms"),
            (stream, "stale_s"),
            (stream, "state_age_s"),
            (limits.HARD_LIMITS["HandSettings"], "reading_age_s"),
        ):
            patch.setitem(settings, name, limits.Range(0, 60_000))

        def run(command):
            patch.setattr(sys, "argv", shlex.split(line_of(command)))
            before = {stop: signal.getsignal(stop) for stop in (signal.SIGINT, signal.SIGTERM)}
            try:
                name = command.replace("-", "_")
                importlib.import_module(f"lerobot.scripts.lerobot_{name}").main()
            finally:
                for stop, handler in before.items():
                    signal.signal(stop, handler)

        yield run


@pytest.fixture(scope="module")
def arm(at_free_places):
    """The stand-ins that the page starts; return the arm's."""
    started = {}
    with ExitStack() as standins:
        for line in re.findall(r"^python -m uniforce_robots\.standins\.(.*)", PAGE, re.MULTILINE):
            name, *options = at_free_places(line).split()
            one = ArmStandIn(*options) if name == "fci" else StandIn(name, *options)
            started[name] = standins.enter_context(one)
        yield started["fci"]


@pytest.fixture(scope="module")
def recorded(run, request):
    """Two episodes by ``lerobot-record``; without the Franka's client by our recorder."""
    root = Path("outputs/recorded").absolute()
    if CLIENT is None:
        return record_synthetic(root, 2, 4)
    request.getfixturevalue("arm")
    run("record")
    return root


@pytest.fixture(scope="module")
def trained(run, recorded):
    run("train")
    return CHECKPOINT.absolute()


def test_the_page_has_every_command_once_and_in_its_table():
    assert all(line_of(command) and f"| `lerobot-{command}` |" in PAGE for command in COMMANDS)


@pytest.mark.realtime
@has_client
def test_record_stores_tactile_cameras_exactly(recorded):
    dataset = LeRobotDataset("local/recorded", root=recorded)
    assert dataset.num_episodes == 2 and dataset.num_frames >= 4
    assert dataset.meta.features["action"]["names"] == list(AXES)
    frame = dataset[dataset.num_frames - 1]
    for key in TACTILE_KEYS:
        assert set(np.unique(frame[key])) == {0.0, 1.0}
    # the arm follows the teleoperator
    assert np.allclose(frame["observation.state"][:3], [0.307, 0, 0.48], atol=0.05)


def test_edit_dataset_leaves_a_whole_dataset(run, recorded):
    run("edit-dataset")
    dataset = LeRobotDataset("local/fewer", root="outputs/fewer")
    assert dataset.num_episodes == 1 and set(TACTILE_KEYS) <= dataset[0].keys()


def test_dataset_viz_writes_an_episode(run, recorded):
    pytest.importorskip("rerun", reason="the extra rerun isn't installed")
    run("dataset-viz")
    assert Path("outputs/viz/local_recorded_episode_0.rrd").stat().st_size > 10_000


def test_train_saves_a_policy_that_feels(trained):
    config = json.loads((trained / "config.json").read_text())
    assert config["type"] == "pi05_uniforce" and config["touch"]["slots"]
    assert any("force_tokens" in name for name in load_file(trained / "model.safetensors"))


def test_eval_scores_the_shipped_policy_with_another_sensor(run):
    run("eval")
    (scene,) = json.loads(Path("outputs/eval/eval_info.json").read_text())["per_task"]
    assert scene["task_group"] == "uniforce_wiping" and len(scene["metrics"]["successes"]) == 1


@pytest.mark.realtime
@has_client
def test_rollout_drives_the_robot(run, arm, trained, monkeypatch):
    send = UniforceFranka.send_action
    sent_y_m = []

    def send_beside(robot, action):
        # two steps of training may teach hardly any motion, so each action is moved by 5 mm
        sent = send(robot, {**action, "y.pos": action["y.pos"] + 0.005})
        sent_y_m.append(sent["y.pos"])
        return sent

    monkeypatch.setattr(UniforceFranka, "send_action", send_beside)
    run("rollout")  # it raises what ends it early
    assert arm.do("look")["arm"]["position_m"][1] == pytest.approx(sent_y_m[-1], abs=0.003)
