"""The stand-in's process through a client of plain sockets: every request, a Move's sequence, every fault.

Times are asserted in the robot's own milliseconds: a busy machine is slow, and the server waits for its client.
"""

import socket

import numpy as np
import pytest
from fci_client import RawArm, RawHand, hand_request, pull_to, wait_until

from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.process import StandIn

pytestmark = pytest.mark.slow
STARTED, PREEMPTED = bytes([p.MoveStatus.MOTION_STARTED]), bytes([p.MoveStatus.PREEMPTED])


def rest(state: p.RobotState) -> p.RobotCommand:
    return p.RobotCommand(state.message_id)


def until_mode(arm: RawArm, mode: p.RobotMode) -> p.RobotState:
    for _ in range(5000):
        state = arm.state()
        if state.mode == mode:
            return state
    raise AssertionError(f"never in mode {mode.name}")


def test_setters_are_answered_and_short_ones_refused(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        assert (arm.status, arm.version) == (p.ConnectStatus.SUCCESS, 10)
        setters = {
            p.ArmCommand.SET_COLLISION_BEHAVIOR: np.full(52, 15.0),
            p.ArmCommand.SET_JOINT_IMPEDANCE: np.full(7, 3000.0),
            p.ArmCommand.SET_CARTESIAN_IMPEDANCE: np.full(6, 200.0),
            p.ArmCommand.SET_EE_TO_K: np.eye(4).ravel(),
            p.ArmCommand.SET_NE_TO_EE: np.eye(4).ravel(),
            p.ArmCommand.SET_LOAD: np.zeros(13),
        }
        for command, values in setters.items():
            assert arm.ask(command, values.tobytes()) == b"\0", command
            assert arm.ask(command, b"short") == bytes([p.SetterStatus.INVALID_ARGUMENT]), command
        assert arm.ask(p.ArmCommand.SET_GUIDING_MODE, bytes(7)) == b"\0"
        assert arm.ask(p.ArmCommand.AUTOMATIC_ERROR_RECOVERY) == b"\0"
        assert arm.ask(p.ArmCommand.STOP_MOVE) == b"\0"
        model = arm.ask(p.ArmCommand.GET_ROBOT_MODEL)
        assert model[:1] == b"\0" and b"fr3_joint7" in model
        assert arm.ask(99) == bytes([p.SetterStatus.INVALID_ARGUMENT])
    sizes = {line["command"]: line["bytes"] for line in fci.wire() if line["what"] == "request"}
    assert sizes["SET_LOAD"] == 12 + 5, "the log has the last request of each kind, here the short one"
    assert {"CONNECT", "GET_ROBOT_MODEL", "SET_GUIDING_MODE"} <= set(sizes)


def test_a_torque_motion_reaches_its_target_and_ends_when_asked(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        goal = arm.state()["O_T_EE"][12:15] + np.array([0, 0, -0.01])
        command_id = arm.start()
        state = arm.loop(pull_to(goal, 3000.0), 400)
        assert (state.mode, state.generator, state.controller) == (p.RobotMode.MOVE, p.NO_GENERATOR + 1, p.EXTERNAL)
        np.testing.assert_allclose(state["O_T_EE"][12:15], goal, atol=2e-3)
        assert arm.ask(p.ArmCommand.SET_LOAD, bytes(104)) == bytes([p.SetterStatus.NOT_POSSIBLE])
        arm.command(p.RobotCommand(state.message_id + 10, finished=True))
        answer = arm.receive()
        assert (answer.command_id, answer.payload) == (command_id, bytes([p.MoveStatus.SUCCESS]))
        until_mode(arm, p.RobotMode.IDLE)


def test_another_motion_than_torque_control_is_refused(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        asked = arm.move(generator=2), arm.receive()
        assert asked[1] == p.Message(p.ArmCommand.MOVE, asked[0], bytes([p.MoveStatus.INVALID_ARGUMENT]))
        arm.start()


def test_a_torque_step_ends_the_motion_before_the_arm_follows(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        arm.state()
        arm.start()
        for _ in range(5):
            state = arm.newest()
            arm.command(p.RobotCommand(state.message_id, np.array([0, 5.0, 0, 0, 0, 0, 0])))
        look = fci.do("look")["arm"]
        assert arm.receive().payload == bytes([p.MoveStatus.REFLEX_ABORTED])
        assert look["errors"] == [p.ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY] and not look["moving"]
        assert look["tau_Nm"] == [0.0] * 7 and look["speed_rad_s"] == 0.0, "it was never followed"


def test_a_second_move_preempts_the_first_and_stop_the_second(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        first = arm.start()
        arm.loop(rest, 3)
        second = arm.move()
        answers = [arm.receive() for _ in range(2)]
        assert [(a.command_id, a.payload) for a in answers] == [(first, PREEMPTED), (second, STARTED)]
        arm.loop(rest, 3)
        stop = arm.send(p.ArmCommand.STOP_MOVE)
        answers = [arm.receive() for _ in range(2)]
        assert [(a.command_id, a.payload) for a in answers] == [(stop, b"\0"), (second, PREEMPTED)]


def test_guiding_refuses_motion_and_lets_itself_be_pushed(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        before = fci.do("guide")["arm"]
        refused = arm.move()
        assert arm.receive().payload == bytes([p.MoveStatus.NOT_POSSIBLE]) and refused
        fci.do("wrench", newtons=[0, 0, -5, 0, 0, 0])
        z = before["position_m"][2]
        wait_until(lambda: fci.do("look")["arm"]["position_m"][2] < z - 0.003, 60)


def test_twenty_missed_commands_end_a_motion_only_where_the_rule_is_on(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        arm.state()
        command_id = arm.start()
        arm.loop(rest, 3)
        begun = fci.do("look")["arm"]["milliseconds"]
        wait_until(lambda: fci.do("look")["arm"]["milliseconds"] > begun + 30, 60)
        assert fci.do("look")["arm"]["moving"]
        fci.do("miss_rule", on=True)
        answer = arm.receive()
        assert (answer.command_id, answer.payload) == (command_id, bytes([p.MoveStatus.REFLEX_ABORTED]))
        assert until_mode(arm, p.RobotMode.REFLEX).errors == {p.ErrorBit.COMMUNICATION_CONSTRAINTS_VIOLATION}


def test_a_client_that_leaves_stops_the_arm_and_makes_room_for_the_next(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        arm.state()
        arm.start()
        with pytest.raises((ConnectionError, OSError)):
            RawArm(fci.address)
    wait_until(lambda: not fci.do("look")["arm"]["moving"], 60)
    with RawArm(fci.address) as arm:
        assert arm.state().mode == p.RobotMode.IDLE


def test_the_hand_moves_grasps_fails_to_and_stops(fci: StandIn) -> None:
    success, move, grasp = p.HandStatus.SUCCESS, p.HandCommand.MOVE, p.HandCommand.GRASP
    around = hand_request(0.03, 0.005, 0.005, 0.5, 20.0)
    with RawHand(fci.address) as hand:
        assert (hand.status, hand.version) == (p.ConnectStatus.SUCCESS, 3)
        assert hand.status_of(move, hand_request(0.06, 0.5)) == success
        assert hand.status_of(grasp, around) == p.HandStatus.UNSUCCESSFUL
        assert hand.status_of(move, hand_request(0.08, 0.5)) == success
        fci.do("object", width_m=0.031)
        assert hand.status_of(grasp, around) == success
        assert fci.do("look")["hand"]["is_grasped"]
        assert hand.status_of(move, hand_request(0.5, 0.2)) == p.HandStatus.FAIL
        running = hand.send(move, hand_request(0.08, 0.001))
        stop = hand.send(p.HandCommand.STOP)
        answers = [hand.receive() for _ in range(2)]
        ended = [(a.command_id, a.payload[0]) for a in answers]
        assert ended == [(running, p.HandStatus.ABORTED), (stop, success)]
        assert hand.status_of(p.HandCommand.HOMING) == success


def test_another_version_is_refused_with_the_servers_own(address: str) -> None:
    with StandIn(address, "--server-version", "9"), RawArm(address) as arm:
        assert (arm.status, arm.version) == (p.ConnectStatus.INCOMPATIBLE_VERSION, 9)


def test_a_mute_server_accepts_and_says_nothing(address: str) -> None:
    with StandIn(address, "--mute") as fci:
        with socket.create_connection((address, p.ARM_PORT), 5.0) as client:
            client.sendall(p.ARM_HEADER.encode(p.Message(0, 1, p.CONNECT.pack(10, 4000))))
            client.settimeout(0.3)
            with pytest.raises(TimeoutError):
                client.recv(1)
        fci.do("mute", on=False)
        wait_until(lambda: answers(address), 60, "a server that has seen its first client leave")


def answers(address: str) -> bool:
    try:
        with RawArm(address) as arm:
            return arm.status == p.ConnectStatus.SUCCESS
    except ConnectionError:  # turned away
        return False


def test_orders_that_make_no_sense_are_refused(fci: StandIn) -> None:
    for order in ({"what": "fly"}, {"what": "wrench", "newtons": [1]}, {"what": "wall"}, {"what": "fault"}):
        with pytest.raises(ValueError, match="Error"):
            fci.do(**order)
    assert not fci.do("look")["arm"]["errors"]
