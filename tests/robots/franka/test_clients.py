"""Arm and hand through the real client, against the stand-in."""

import importlib.util
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from fci_client import wait_until
from robot_fakes import refused

from uniforce_robots.fr3 import HAND_TO_FLANGE, rotation_z
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.arm import ArmSetup, Gains, advised, require_setup
from uniforce_robots.franka.children import common
from uniforce_robots.franka.clients import (
    CLIENT,
    EXTRA,
    HAND_PORT,
    Arm,
    HandClient,
    is_hand_closed,
    require_installed,
)
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.limits import HandSettings
from uniforce_robots.standins.fci.process import StandIn
from uniforce_vtla.hand import Hand, HandCommand

CHILDREN = Path(common.__file__).parent
PATIENCE_s = 60.0  # a busy machine; the robot's own clock is what is asserted on
BOX = GuardLimits(low=(0.2, -0.3, 0.1, -np.pi, 0.0), high=(0.7, 0.3, 0.6, np.pi, 0.08))


@pytest.fixture
def config(address, tmp_path, patient):
    if importlib.util.find_spec(CLIENT) is None:
        pytest.skip(f"{CLIENT} is not installed: pip install '.[{EXTRA}]' to run the real client")
    return UniforceFrankaConfig(
        id="test",
        calibration_dir=tmp_path,
        address=address,
        connect_deadline_s=PATIENCE_s,
        stream=patient,
        guards=BOX,
        gripper=HandSettings(reading_age_s=PATIENCE_s),
    )


@pytest.fixture
def arm(config, fci):
    arm = Arm(config)
    arm.connect()
    yield arm
    arm.close()
    arm.close()


def wait(condition, what):
    wait_until(condition, PATIENCE_s, what)


def shown(fci, device="arm"):
    return fci.do("look")[device]


def assert_still(fci):
    """Assert that the arm rests a fifth of a second later, by its clock; it brakes in a tenth."""
    later_ms = shown(fci)["milliseconds"] + 200
    wait(lambda: shown(fci)["milliseconds"] >= later_ms, "a fifth of a second")
    assert shown(fci)["speed_rad_s"] < 1e-3, "the arm still moves"


def test_connecting_moves_nothing_a_target_is_reached_and_stop_rests(arm, fci):
    state = arm.state()
    look = shown(fci)
    np.testing.assert_allclose(state.ee_to_base[:3, 3], look["position_m"], atol=1e-4)
    np.testing.assert_allclose(state.ee_to_base[:3, :3], look["rotation"], atol=1e-4)
    np.testing.assert_allclose(state.q_rad, look["q_rad"], atol=1e-4)
    assert state.mode == "idle" and not look["moving"]
    goal = state.ee_to_base.copy()
    goal[:3, 3] += [0.005, 0, -0.01]

    def arrived():
        arm.set_target(goal)  # again and again: a target that is not repeated is let go of
        return bool(np.abs(shown(fci)["position_m"] - goal[:3, 3]).max() < 2e-3)

    wait(arrived, "the target")
    wait(lambda: arm.state().mode == "move", "the mode")
    arm.stop()
    assert_still(fci)
    assert shown(fci)["mode"] == "IDLE"
    here = arm.state().ee_to_base
    arm.set_target(here)
    wait(lambda: shown(fci)["moving"], "control again")
    arm.close()
    assert_still(fci)
    thresholds = [line for line in fci.wire() if line["what"] == "thresholds"]
    assert thresholds[-1]["upper_force_N"] == [40.0] * 6


def test_however_far_the_target_the_press_is_stiffness_times_clip(config, fci):
    config.gains = Gains((400.0, 400.0, 400.0), clip_m=(0.01, 0.01, 0.01))
    arm = Arm(config)
    arm.connect()
    pose = arm.state().ee_to_base
    fci.do("wall", height_m=float(pose[2, 3]) - 0.002, stiffness_N_m=20000.0)
    pose[2, 3] -= 0.3
    pressed = []

    def settles():
        arm.set_target(pose)
        look = shown(fci)
        pressed.append(look["contact_N"][2])
        return look["speed_rad_s"] < 2e-3 and pressed[-1] > 2.0

    wait(settles, "a steady press")
    assert abs(pressed[-1] - 4.0) < 0.8, f"pressed {pressed[-1]:.2f} N, stiffness × clip is 4 N"
    arm.close()


def test_a_parent_that_falls_silent_leaves_a_spring_that_pulls_at_nothing(arm, fci):
    fci.do("wall", height_m=float(arm.state().ee_to_base[2, 3]) - 0.001)
    goal = arm.state().ee_to_base
    goal[2, 3] -= 0.015

    def pressed():
        return float(shown(fci)["contact_N"][2])

    def presses():
        arm.set_target(goal)
        return pressed() > 5.0

    wait(presses, "a press")
    wait(lambda: pressed() < 2.0, "a spring that has let go")


def test_the_hand_opens_grasps_and_fails_to_one_command_at_a_time(config, fci):
    client = HandClient(config)
    hand = Hand(client, config.gripper)
    hand.start()
    assert abs(hand.reading.width_m - 0.08) < 1e-6

    def ticks_until(condition, what):
        wait(lambda: hand.tick() or (condition() and not hand.is_busy), what)

    fci.do("object", width_m=0.03)
    hand.submit(0.02)
    ticks_until(lambda: hand.reading.is_grasped, "a grasp")
    assert abs(shown(fci, "hand")["force_N"] - 10.0) < 1e-9
    hand.submit(0.06)
    ticks_until(lambda: abs(hand.reading.width_m - 0.06) < 1e-3, "an open hand")
    fci.do("object", width_m=0.0)
    hand.submit(0.02)
    ticks_until(
        lambda: hand.reading.width_m < 0.021, "fingers at the wished width, without an object"
    )
    closed_m = shown(fci, "hand")["width_m"]
    assert closed_m > 0.005, "stopped on the way, not closed fully"
    hand.submit(0.08)
    wait(lambda: hand.tick() or shown(fci, "hand")["width_m"] > closed_m + 0.01, "a moving hand")
    client.close()
    stopped_m = shown(fci, "hand")["width_m"]
    assert stopped_m < 0.07, "the fingers stop at the end, not when they have arrived"
    time.sleep(0.1)
    assert shown(fci, "hand")["width_m"] == stopped_m
    requests = [r for r in fci.wire() if r["what"] == "request" and r["device"] == "hand"]
    assert {r["command"] for r in requests if r["busy"]} == {"STOP"}, (
        "nothing else interrupts a command"
    )


def test_a_parent_that_falls_silent_leaves_fingers_at_rest(config, fci):
    client = HandClient(config)
    client.connect()
    client.begin(HandCommand(0.0, 0.02, 10.0))
    wait(lambda: shown(fci, "hand")["width_m"] < 0.079, "moving fingers")
    end = {"say": "outcome", "ok": False}
    wait(lambda: client._child.poll() == end, "the end, unasked")
    stopped_m = shown(fci, "hand")["width_m"]
    assert stopped_m > 0.03
    time.sleep(0.2)
    assert shown(fci, "hand")["width_m"] == stopped_m
    client.close()


def test_a_program_that_ends_by_a_mistake_leaves_arm_and_fingers_at_rest(fci, config):
    program = (
        "import sys; from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig\n"
        "config = UniforceFrankaConfig(address=sys.argv[1], connect_deadline_s=60)\n"
        "robot = UniforceFranka(config); robot.connect()\n"
        "robot.send_action(robot.get_observation() | {'width.pos': 0.0})\n"
        "sys.stdin.readline(); raise ValueError('oh')"
    )
    command = [sys.executable, "-c", program, fci.address]
    pipe = subprocess.PIPE
    child = subprocess.Popen(command, stdin=pipe, stderr=pipe, text=True)
    wait(lambda: shown(fci, "hand")["width_m"] < 0.079, "moving fingers")
    said = child.communicate("\n", timeout=PATIENCE_s)[1]
    assert child.returncode == 1 and "ValueError: oh" in said and "Fatal" not in said
    stopped = fci.do("look")
    time.sleep(0.3)
    assert shown(fci, "hand") == stopped["hand"]
    assert_still(fci)


def test_the_robot_from_end_to_end(config, fci):
    """Act, be stopped by a person, refuse, recover, leave the arm still."""
    robot = UniforceFranka(config)
    robot.connect()
    goal = robot.get_observation()
    goal["z.pos"] -= 0.01
    goal["width.pos"] = 0.05

    def arrived():
        robot.send_action(goal)
        seen = robot.get_observation()
        # closing is stopped by the hand's own reading, ten a second
        return abs(seen["z.pos"] - goal["z.pos"]) < 2e-3 and 0.043 < seen["width.pos"] < 0.051

    wait(arrived, "arm and hand at the goal")
    fci.do("user_stop")
    with refused("user_stop"):
        wait(lambda: not robot.send_action(goal), "a refusal")
    assert_still(fci)
    with refused("user_stop"):  # the button is still pressed
        robot.recover()
    fci.do("release")
    robot.recover()
    assert not shown(fci)["moving"], "recovery moves nothing"
    robot.send_action(robot.get_observation())
    wait(lambda: shown(fci)["moving"], "control again")
    robot.disconnect()
    assert_still(fci)
    assert not shown(fci)["moving"]


def test_another_server_version_is_refused_with_its_own_words(config):
    with StandIn(config.address, "--server-version", "9"), refused("version", match="9"):
        Arm(config).connect()


def test_a_server_that_never_answers_is_an_error_at_the_deadline(config, caplog):
    config.connect_deadline_s = 1.0
    with StandIn(config.address, "--mute"), caplog.at_level(logging.INFO):
        with refused("connection", match=r"none after 1\.0 s"):
            Arm(config).connect()
        ended = time.time()
    [loaded] = [record.created for record in caplog.records if "client loaded" in record.message]
    assert ended - loaded < 1.5


def test_ctrl_c_at_the_terminal_leaves_a_child_to_its_parent():
    """Else both clients die in the middle of a motion, and their tracebacks bury the recorder's."""
    program = "import common\n"
    program += "common.serve('json', lambda _: common.say('ended', orders=common.orders(20)))"
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    command = [sys.executable, "-c", program]
    child = subprocess.Popen(command, text=True, cwd=CHILDREN, **pipes)
    assert '"loaded"' in child.stdout.readline()
    child.send_signal(signal.SIGINT)
    assert child.communicate(timeout=20) == ('{"say": "ended", "orders": null}\n', "")
    assert child.returncode == 0


def test_a_client_that_is_not_installed_is_named_with_its_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with refused("backend", match=r"\[franka\]"):
        require_installed()


def test_a_foreign_tool_or_load_is_refused_by_name():
    turned = HAND_TO_FLANGE @ rotation_z(np.pi / 4)
    turned[2, 3] += 0.06
    require_setup(ArmSetup(HAND_TO_FLANGE, 0.3), load_kg=0.3)
    with refused("frame", match="60 mm away and turned by 45°"):
        require_setup(ArmSetup(turned, 0.0), load_kg=0.0)
    with refused("frame", match="1 kg"):
        require_setup(ArmSetup(HAND_TO_FLANGE, 1.0), load_kg=0.0)


def test_a_kernel_without_real_time_is_told_what_helps():
    assert advised("libfranka: no realtime capabilities.").endswith("or boot a PREEMPT_RT kernel.")


def test_a_connection_that_the_hand_has_closed_is_seen_from_outside_the_client(address):
    with ExitStack() as closing:
        server = closing.enter_context(socket.create_server((address, HAND_PORT)))
        closing.enter_context(socket.create_connection((address, HAND_PORT)))
        accepted, _ = server.accept()
        assert not is_hand_closed(os.getpid())
        accepted.close()
        time.sleep(0.05)
        assert is_hand_closed(os.getpid())
