"""A client of the arm and of the hand in plain sockets, so that the wire can be tested without a vendor's wheel."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Self

import numpy as np

from uniforce_robots.standins.fci.kinematics import JOINTS
from uniforce_robots.standins.fci.protocol import (
    ARM_HEADER,
    ARM_PORT,
    ARM_VERSION,
    HAND_HEADER,
    HAND_PORT,
    HAND_VERSION,
    ArmCommand,
    ConnectRequest,
    Controller,
    Generator,
    HandCommand,
    HandState,
    Header,
    Message,
    MoveRequest,
    RobotCommand,
    RobotState,
    unpack,
)
from uniforce_robots.standins.fci.rules import TORQUE_STEP_Nm

ARM_GREETING, HAND_GREETING = struct.Struct("<BH"), struct.Struct("<HH")  # status, version
HAND_STATUS = struct.Struct("<H")

TIMEOUT_s = 30.0  # a busy machine is slow, a hung server is for ever


class RawClient:
    """One TCP connection, one UDP socket, answers matched by command id."""

    def __init__(self, address: str, port: int, header: Header) -> None:
        tcp = socket.create_connection((address, port), TIMEOUT_s)
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        udp.bind((tcp.getsockname()[0], 0))  # states go to the address the TCP connection came from
        udp.settimeout(TIMEOUT_s)
        self._talk(tcp, udp, header)

    @classmethod
    def on(cls, tcp: socket.socket, udp: socket.socket, header: Header) -> Self:
        """Return a client of sockets that are open already, before it has greeted."""
        client = cls.__new__(cls)
        client._talk(tcp, udp, header)
        return client

    def _talk(self, tcp: socket.socket, udp: socket.socket, header: Header) -> None:
        self.tcp, self.udp, self.header = tcp, udp, header
        self.server: tuple[str, int] | None = None
        self._buffer = b""
        self._next_id = 1

    def __enter__(self) -> RawClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up."""
        self.tcp.close()
        self.udp.close()

    def send(self, command: int, payload: bytes = b"") -> int:
        """Send a request; return its id."""
        command_id, self._next_id = self._next_id, self._next_id + 1
        self.tcp.sendall(self.header.encode(Message(command, command_id, payload)))
        return command_id

    def receive(self) -> Message:
        """Return the next answer; raise ConnectionError when the server hung up."""
        while True:
            message, self._buffer = self.header.decode(self._buffer)
            if message is not None:
                return message
            data = self.tcp.recv(65536)
            if not data:
                raise ConnectionError("the server hung up")
            self._buffer += data

    def ask(self, command: int, payload: bytes = b"") -> bytes:
        """Send a request and return its answer's payload."""
        command_id = self.send(command, payload)
        answer = self.receive()
        if (answer.command, answer.command_id) != (command, command_id):
            raise ConnectionError(
                f"answer to ({command}, {command_id}) was ({answer.command}, {answer.command_id})"
            )
        return answer.payload

    def datagram(self) -> bytes:
        """Return the next datagram and remember who sent it."""
        data, self.server = self.udp.recvfrom(65536)
        return data

    def _greet(self, command: int, version: int) -> bytes:
        return self.ask(command, ConnectRequest(version, self.udp.getsockname()[1]).encode())


class RawArm(RawClient):
    """The arm's port."""

    _tau_Nm: np.ndarray = np.zeros(JOINTS)  # last sent

    def __init__(self, address: str, version: int = ARM_VERSION) -> None:
        super().__init__(address, ARM_PORT, ARM_HEADER)
        self.greet(version)

    def greet(self, version: int) -> None:
        """Say hello; keep what the server answered."""
        answer = self._greet(ArmCommand.CONNECT, version)
        self.status, self.version = unpack(ARM_GREETING, answer, "answer to Connect")

    def state(self) -> RobotState:
        """Return the next state, in order: older ones may be queued."""
        return RobotState.decode(self.datagram())

    def newest(self) -> RobotState:
        """Return the newest state, skipping what is queued."""
        state = self.state()
        self.udp.setblocking(False)
        try:
            while True:
                state = self.state()
        except BlockingIOError:
            return state
        finally:
            self.udp.settimeout(TIMEOUT_s)

    def move(
        self, generator: Generator = Generator.NONE, controller: Controller = Controller.EXTERNAL
    ) -> int:
        """Ask for a motion; return the request's id. The first answer is still to be received."""
        self._tau_Nm = np.zeros(JOINTS)
        return self.send(ArmCommand.MOVE, MoveRequest(controller, generator).encode())

    def command(self, command: RobotCommand) -> None:
        """Send a command of the control loop."""
        if self.server is None:
            raise ConnectionError("no state has come yet: where commands go is not known")
        self.udp.sendto(command.encode(), self.server)

    def loop(self, law: Callable[[RobotState], RobotCommand], ticks: int) -> RobotState:
        """Answer so many states with a control law, its torques limited in rate; return the last one."""
        for _ in range(ticks):
            state = self.newest()
            command = law(state)
            self._tau_Nm = self._tau_Nm + np.clip(
                command.tau_J_d - self._tau_Nm, -TORQUE_STEP_Nm, TORQUE_STEP_Nm
            )
            self.command(replace(command, tau_J_d=self._tau_Nm))
        return state


def pull_to(
    target_m: np.ndarray, jacobian: Callable[[np.ndarray], np.ndarray], stiffness_N_m: float = 1000.0
) -> Callable[[RobotState], RobotCommand]:
    """Return a control law: a damped spring from the hand to a point, through a Jacobian of the joint angles."""

    def law(state: RobotState) -> RobotCommand:
        J = jacobian(state["q"].astype(float))
        error = np.concatenate([target_m - state["O_T_EE"][12:15], np.zeros(3)])
        damping = np.array([90.0] * 3 + [10.0] * 3)
        force = np.array([stiffness_N_m] * 3 + [0.0] * 3) * error - damping * (J @ state["dq"])
        return RobotCommand(state.message_id, tau_J_d=J.T @ force)

    return law


class RawHand(RawClient):
    """The hand's port."""

    def __init__(self, address: str, version: int = HAND_VERSION) -> None:
        super().__init__(address, HAND_PORT, HAND_HEADER)
        self.greet(version)

    def greet(self, version: int) -> None:
        """Say hello; keep what the server answered."""
        answer = self._greet(HandCommand.CONNECT, version)
        self.status, self.version = unpack(HAND_GREETING, answer, "answer to Connect")

    def state(self) -> HandState:
        """Return the next state."""
        return HandState.decode(self.datagram())

    def status_of(self, command: int, payload: bytes = b"") -> int:
        """Send a request and return how it ended."""
        return int(unpack(HAND_STATUS, self.ask(command, payload), "answer of the hand")[0])
