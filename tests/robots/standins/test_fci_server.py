"""The stand-in through a client of plain sockets: unusual requests, and refusals.

Times are asserted in the robot's own milliseconds: a busy machine is slow, and the server waits for
its client.
"""

import socket

import pytest
from fci_client import RawArm, RawHand, hand_request, wait_until

from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.process import StandIn

STARTED = bytes([p.MoveStatus.MOTION_STARTED])
PREEMPTED = bytes([p.MoveStatus.PREEMPTED])


def rest(state):
    return p.RobotCommand(state.message_id)


def next_answers(arm):
    answers = [arm.receive() for _ in range(2)]
    return [(answer.command_id, answer.payload) for answer in answers]


def test_what_makes_no_sense_is_refused(fci):
    invalid = bytes([p.SetterStatus.INVALID_ARGUMENT])
    with RawArm(fci.address) as arm:
        for command in [*p.SETTERS, 99]:
            assert arm.ask(command, b"short") == invalid, command
        another = arm.move(generator=2)
        answer = bytes([p.MoveStatus.INVALID_ARGUMENT])
        assert arm.receive() == p.Message(p.ArmCommand.MOVE, another, answer)
        arm.start()
        assert arm.ask(p.ArmCommand.SET_LOAD, bytes(104)) == bytes([p.SetterStatus.NOT_POSSIBLE])
    with RawHand(fci.address) as hand:
        assert hand.status_of(p.HandCommand.MOVE, hand_request(0.5, 0.2)) == p.HandStatus.FAIL
        assert hand.status_of(p.HandCommand.HOMING) == p.HandStatus.SUCCESS


def test_a_second_move_preempts_the_first_and_stop_the_second(fci):
    with RawArm(fci.address) as arm:
        first = arm.start()
        arm.loop(rest, 3)
        second = arm.move()
        assert next_answers(arm) == [(first, PREEMPTED), (second, STARTED)]
        arm.loop(rest, 3)
        stop = arm.send(p.ArmCommand.STOP_MOVE)
        assert next_answers(arm) == [(stop, b"\0"), (second, PREEMPTED)]


def test_guiding_refuses_motion_and_lets_itself_be_pushed(fci):
    with RawArm(fci.address) as arm:
        z = fci.do("guide")["arm"]["position_m"][2]
        arm.move()
        assert arm.receive().payload == bytes([p.MoveStatus.NOT_POSSIBLE])
        fci.do("wrench", newtons=[0, 0, -5, 0, 0, 0])
        wait_until(lambda: fci.do("look")["arm"]["position_m"][2] < z - 0.003, 60)


def test_a_client_that_leaves_stops_the_arm_and_makes_room_for_the_next(fci):
    with RawArm(fci.address) as arm:
        arm.state()
        arm.start()
        with pytest.raises((ConnectionError, OSError)):
            RawArm(fci.address)
    wait_until(lambda: not fci.do("look")["arm"]["moving"], 60)
    with RawArm(fci.address) as arm:
        assert arm.state().mode == p.RobotMode.IDLE


def test_a_mute_server_accepts_and_says_nothing(address):
    with StandIn(address, "--mute") as fci:
        with socket.create_connection((address, p.ARM_PORT), 5.0) as client:
            client.sendall(p.ARM_HEADER.encode(p.Message(0, 1, p.CONNECT.pack(10, 4000))))
            client.settimeout(0.3)
            with pytest.raises(TimeoutError):
                client.recv(1)
        fci.do("mute", on=False)
        wait_until(lambda: answers(address), 60, "a server that has seen its first client leave")


def answers(address):
    try:
        with RawArm(address) as arm:
            return arm.status == p.ConnectStatus.SUCCESS
    except ConnectionError:  # turned away
        return False


def test_orders_that_make_no_sense_are_refused(fci):
    for order in (
        {"what": "fly"},
        {"what": "wrench", "newtons": [1]},
        {"what": "wall"},
        {"what": "fault"},
    ):
        with pytest.raises(ValueError, match="Error"):
            fci.do(**order)
    assert not fci.do("look")["arm"]["errors"]
