"""The arm's requests by TCP: greeting, Move and its end, recovery, the model, setters."""

from __future__ import annotations

import struct

from uniforce_robots.standins.fci.arm_settings import setting
from uniforce_robots.standins.fci.control_loop import ArmOptions, ControlLoop
from uniforce_robots.standins.fci.journal import Journal
from uniforce_robots.standins.fci.kinematics import urdf
from uniforce_robots.standins.fci.motion import Motion
from uniforce_robots.standins.fci.protocol import (
    ARM_HEADER,
    ArmCommand,
    ConnectRequest,
    ConnectStatus,
    Message,
    MoveRequest,
    MoveStatus,
    ProtocolError,
    RobotMode,
    SetterStatus,
)


class ArmService(ControlLoop):
    """An arm behind its port."""

    def __init__(self, address: str, options: ArmOptions, journal: Journal) -> None:
        super().__init__(address, options, journal)
        self._model = urdf().encode()

    def handle(self, message: Message) -> None:
        """Answer one request; a payload that can't be read ends the connection."""
        name = ArmCommand(message.command).name if message.command in list(ArmCommand) else "?"
        size = ARM_HEADER.layout.size + len(message.payload)
        self.journal.write("request", device="arm", command=name, command_id=message.command_id, bytes=size)
        try:
            self._dispatch(message)
        except ProtocolError as error:
            self.client_gone()
            self.link.drop(str(error))

    def _dispatch(self, message: Message) -> None:
        match message.command:
            case ArmCommand.CONNECT:
                self._connect(message)
            case ArmCommand.MOVE:
                self._move(message)
            case ArmCommand.STOP_MOVE:
                self._stop_move(message)
            case ArmCommand.AUTOMATIC_ERROR_RECOVERY:
                self._recover(message)
            case ArmCommand.GET_ROBOT_MODEL:
                self.link.send(Message(message.command, message.command_id, b"\0" + self._model))
            case _:
                self._set(message)

    def _connect(self, message: Message) -> None:
        request = ConnectRequest.decode(message.payload)
        fits = request.version == self.options.version
        status = ConnectStatus.SUCCESS if fits else ConnectStatus.INCOMPATIBLE_VERSION
        self.link.greet(message, request, struct.pack("<BH", status, self.options.version), fits)

    def _move(self, message: Message) -> None:
        request = MoveRequest.decode(message.payload)
        if self.mode not in (RobotMode.IDLE, RobotMode.MOVE):
            self._reply(message, MoveStatus.NOT_POSSIBLE)
            return
        if self.motion is not None:
            self.end_motion(MoveStatus.PREEMPTED)
        self._reply(message, MoveStatus.MOTION_STARTED)
        self.motion = Motion(message.command_id, request)
        self.mode, self.success_rate = RobotMode.MOVE, 1.0
        modes = {"controller": request.controller.name, "generator": request.generator.name}
        self.journal.write("motion", **modes)

    def _stop_move(self, message: Message) -> None:
        self._reply(message, SetterStatus.SUCCESS)
        if self.motion is not None:
            self.end_motion(MoveStatus.PREEMPTED)

    def _recover(self, message: Message) -> None:
        if self.mode == RobotMode.USER_STOPPED:
            self._reply(message, SetterStatus.NOT_POSSIBLE)
            return
        if self.mode == RobotMode.REFLEX:
            self.mode, self.errors = RobotMode.IDLE, frozenset()
        self._reply(message, SetterStatus.SUCCESS)

    def _set(self, message: Message) -> None:
        """Answer a setter; while the arm moves, the real one refuses what would change its dynamics."""
        try:
            apply = setting(self.arm, self.journal, message)
        except ProtocolError as error:
            self.journal.write("invalid", why=str(error))
            self._reply(message, SetterStatus.INVALID_ARGUMENT)
            return
        if self.motion is not None:
            self._reply(message, SetterStatus.NOT_POSSIBLE)
            return
        apply()
        self._reply(message, SetterStatus.SUCCESS)

    def _reply(self, message: Message, status: int) -> None:
        self.link.send(Message(message.command, message.command_id, bytes([status])))
