"""The arm's side of the wire: requests by TCP, a Move, a millisecond driven and sent, its stops."""

import struct
import time
from dataclasses import dataclass
from math import cos, sin

import numpy as np

from uniforce_robots.fr3 import DH, DQ_MAX_rad_s, FLANGE_m, Q_MAX_rad, Q_MIN_rad, TAU_MAX_Nm
from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.arm import Arm, TICK_s, broken_rules
from uniforce_robots.standins.fci.link import Journal, Link

# of a tick with its client: time passes slower instead of the arm following a stale torque
PATIENCE_s = 0.02
SUCCESS_WINDOW = 100  # commands the success rate is about
MISSES_ALLOWED = 20  # FCI: as many lost packets in a row end the motion
STOPPED = (p.RobotMode.REFLEX, p.RobotMode.USER_STOPPED)
LINK_MASS_kg = (3.0, 4.0, 2.5, 3.0, 2.5, 2.0, 1.5, 0.6, 0.05)  # link 0 to flange, plausible


@dataclass
class Motion:
    """A Move under way."""

    command_id: int
    command: p.RobotCommand | None = None  # the newest
    answered: bool = False  # whether the last state has got its command
    misses: int = 0  # in a row
    broken: frozenset[int] = frozenset()  # rules, by commands that wait to be followed


class ArmService:
    """An arm behind its port; torque control is the only motion it knows.

    The server's version is ``version``; another than 10 refuses every client of version 10.
    ``miss_rule`` ends a motion after 20 missed commands, as the real arm does; a tick waits 1 ms
    only then. Off at first: it would test a machine's kernel, not the client.
    """

    def __init__(self, address: str, version: int, journal: Journal) -> None:
        self.link = Link(address, p.ARM_PORT, p.ARM_HEADER, journal)
        self.version = version
        self.journal = journal
        self.arm = Arm()
        self.mode = p.RobotMode.IDLE
        self.motion: Motion | None = None
        self.errors: frozenset[int] = frozenset()
        self.reflex_reason: frozenset[int] = frozenset()
        self.success_rate = 0.0
        self.miss_rule = False
        self.milliseconds = 0
        self.sent_s = 0.0  # CLOCK_MONOTONIC, of the newest state

    # --- requests -----------------------------------------------------------------------------

    def answer(self, message: p.Message) -> None:
        """Answer one request; p.ProtocolError: a payload that can't be read."""
        self.link.write_request(message, p.ArmCommand)
        match message.command:
            case p.ArmCommand.CONNECT:
                self.link.greet(message, self.version, struct.Struct("<BH").pack)
            case p.ArmCommand.MOVE:
                self._move(message)
            case p.ArmCommand.STOP_MOVE:
                self._reply(message, p.SetterStatus.SUCCESS)
                if self.motion is not None:
                    self.end_motion(p.MoveStatus.PREEMPTED)
            case p.ArmCommand.AUTOMATIC_ERROR_RECOVERY:
                self._recover(message)
            case p.ArmCommand.GET_ROBOT_MODEL:
                self.link.reply(message, b"\0" + urdf().encode())
            case _:
                self._reply(message, self._set(message))

    def _move(self, message: p.Message) -> None:
        controller, generator, *_ = p.unpack(p.MOVE, message.payload, "Move")
        if (controller, generator) != p.TORQUE_CONTROL:
            self._reply(message, p.MoveStatus.INVALID_ARGUMENT)
            return
        if self.mode not in (p.RobotMode.IDLE, p.RobotMode.MOVE):
            self._reply(message, p.MoveStatus.NOT_POSSIBLE)
            return
        if self.motion is not None:
            self.end_motion(p.MoveStatus.PREEMPTED)
        self._reply(message, p.MoveStatus.MOTION_STARTED)
        self.motion = Motion(message.command_id)
        self.mode = p.RobotMode.MOVE
        self.success_rate = 1.0
        self.journal.write("motion")

    def _recover(self, message: p.Message) -> None:
        if self.mode == p.RobotMode.USER_STOPPED:
            self._reply(message, p.SetterStatus.NOT_POSSIBLE)
            return
        if self.mode == p.RobotMode.REFLEX:
            self.mode = p.RobotMode.IDLE
            self.errors = frozenset()
        self._reply(message, p.SetterStatus.SUCCESS)

    def _set(self, message: p.Message) -> p.SetterStatus:
        """Obey a setter; while the arm moves, the real one refuses what would change its dynamics.

        Its thresholds are the only ones that this arm's behaviour depends on.
        """
        try:
            if message.command not in p.SETTERS:
                raise p.ProtocolError("arm command", "0 to 11", message.command)
            command = p.ArmCommand(message.command)
            values = p.numbers(struct.Struct(p.SETTERS[command]), message.payload, command.name)
        except p.ProtocolError as error:
            self.journal.write("invalid", why=str(error))
            return p.SetterStatus.INVALID_ARGUMENT
        if self.motion is not None:
            return p.SetterStatus.NOT_POSSIBLE
        if command == p.ArmCommand.SET_COLLISION_BEHAVIOR:
            torque_Nm = values[p.UPPER_TORQUE]
            force_N = values[p.UPPER_FORCE]
            self.arm.upper_torque_Nm = torque_Nm
            self.arm.upper_force_N = force_N
            limits = {"upper_torque_Nm": torque_Nm.tolist(), "upper_force_N": force_N.tolist()}
            self.journal.write("thresholds", **limits)
        return p.SetterStatus.SUCCESS

    def _reply(self, message: p.Message, status: int) -> None:
        self.link.reply(message, bytes([status]))

    # --- control loop -------------------------------------------------------------------------

    def receive_command(self, datagram: bytes) -> None:
        """Take a command of the control loop."""
        try:
            command = p.RobotCommand.decode(datagram)
        except p.ProtocolError as error:
            self.journal.write("invalid", why=str(error), bytes=len(datagram))
            return
        if self.journal.is_on:
            tau_Nm = command.tau_J_d.round(4).tolist()
            self.journal.write(
                "command", id=command.message_id, tau_Nm=tau_Nm, finished=command.finished
            )
        if (motion := self.motion) is not None:
            before_Nm = motion.command.tau_J_d if motion.command else 0.0
            motion.broken |= broken_rules(command.tau_J_d, before_Nm)
            motion.command = command
            motion.answered = command.message_id >= self.milliseconds

    def is_due(self, now_s: float) -> bool:
        """Return whether the next millisecond may begin: the client answered, or took too long."""
        if self.motion is None or self.motion.answered:
            return True
        return now_s - self.sent_s >= (TICK_s if self.miss_rule else PATIENCE_s)

    def tick(self) -> None:
        """Let one millisecond of the robot's time pass and send a state."""
        if self.motion is not None and self.motion.command is not None:
            self._drive(self.motion, self.motion.command)
        elif self.mode == p.RobotMode.GUIDING:
            self.arm.guide()
        else:
            self.arm.hold()  # also while the client of a motion has not begun
        self.milliseconds += 1
        self._send_state()

    def _drive(self, motion: Motion, command: p.RobotCommand) -> None:
        motion.misses = 0 if motion.answered else motion.misses + 1
        self.success_rate += (float(motion.answered) - self.success_rate) / SUCCESS_WINDOW
        motion.answered = False
        violations = motion.broken
        if not violations:
            self.arm.drive(command.tau_J_d)
            violations = self.arm.violations()
            if self.miss_rule and motion.misses >= MISSES_ALLOWED:
                violations |= {p.ErrorBit.COMMUNICATION_CONSTRAINTS_VIOLATION}
        if violations:
            self.reflex(violations)
        elif command.finished:
            self.end_motion(p.MoveStatus.SUCCESS)

    def _send_state(self) -> None:
        self.sent_s = time.monotonic()
        state = self.state()
        if self.journal.is_on:
            position_m = self.arm.ee_to_base[:3, 3].round(6).tolist()
            self.journal.write(
                "state", id=state.message_id, mode=self.mode.name, position_m=position_m
            )
        self.send(state)

    def send(self, state: p.RobotState) -> None:
        """Send a state to the client."""
        self.link.send_state(state.encode())

    def state(self) -> p.RobotState:
        """Return what the arm says of itself now."""
        generator = 0
        controller = p.OTHER
        success_rate = 0.0
        if self.motion is not None:
            generator = p.NO_GENERATOR + 1
            controller = p.EXTERNAL
            success_rate = self.success_rate
        return p.RobotState(
            self.milliseconds,
            self.arm.state_floats(),
            generator,
            controller,
            self.errors,
            self.reflex_reason,
            self.mode,
            success_rate,
        )

    # --- stops --------------------------------------------------------------------------------

    def end_motion(self, status: p.MoveStatus, mode: p.RobotMode = p.RobotMode.IDLE) -> None:
        """Show the new mode in a state first, then answer the Move: the order clients wait for."""
        motion = self.motion
        self.motion = None
        self.mode = mode
        self._send_state()
        if motion is not None:
            self._reply(p.Message(p.ArmCommand.MOVE, motion.command_id), status)

    def client_gone(self) -> None:
        """Brake when the client has left: no answer is sent."""
        if self.motion is not None:
            self.journal.write("motion lost its client")
            self.motion = None
            self.mode = p.RobotMode.IDLE

    def reflex(self, errors: frozenset[int]) -> None:
        """Stop by reflex; motion is refused until recovery."""
        self.errors = self.reflex_reason = errors
        self.journal.write("reflex", errors=sorted(int(e) for e in errors))
        self.end_motion(p.MoveStatus.REFLEX_ABORTED, p.RobotMode.REFLEX)

    def user_stop(self) -> None:
        """Press the stop button."""
        self.journal.write("user stop")
        self.end_motion(p.MoveStatus.EMERGENCY_ABORTED, p.RobotMode.USER_STOPPED)

    def release(self) -> None:
        """Let go of the stop button or of the guiding buttons."""
        if self.mode in (p.RobotMode.USER_STOPPED, p.RobotMode.GUIDING):
            self.mode = p.RobotMode.IDLE

    def guide(self) -> None:
        """Press the guiding buttons at the flange."""
        self.journal.write("guiding")
        if self.mode not in STOPPED:
            self.end_motion(p.MoveStatus.ABORTED, p.RobotMode.GUIDING)

    def describe(self) -> dict[str, object]:
        """Return what a test wants to know without a client."""
        return {
            "milliseconds": self.milliseconds,
            "mode": self.mode.name,
            "moving": self.motion is not None,
            **self.arm.describe(),
            "errors": sorted(int(e) for e in self.errors),
        }


URDF_LINK = (
    '<link name="link{0}"><inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="{1}"/>'
    '<inertia ixx="{2}" iyy="{2}" izz="{2}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
URDF_JOINT = (
    '<joint name="fr3_joint{1}" type="revolute"><parent link="link{0}"/><child link="link{1}"/>'
    '<origin xyz="{2}" rpy="{3:.12g} 0 0"/><axis xyz="0 0 1"/>'
    '<limit lower="{4}" upper="{5}" velocity="{6}" effort="{7}"/>'
    '<position_based_velocity_limits velocity_offset="0.3" deceleration_limit="6.0"/></joint>'
)
URDF_FLANGE = (
    '<joint name="fr3_joint8" type="fixed"><parent link="link7"/><child link="link8"/>'
    '<origin xyz="0 0 {}" rpy="0 0 0"/></joint>'
)


def urdf() -> str:
    """Return the model a client downloads, with the names and limit tags of libfranka's loader."""
    parts = [URDF_LINK.format(i, mass, 0.004 * mass) for i, mass in enumerate(LINK_MASS_kg)]
    limits = np.column_stack([Q_MIN_rad, Q_MAX_rad, DQ_MAX_rad_s, TAU_MAX_Nm]).tolist()
    for i, (a, d, alpha) in enumerate(DH.tolist()):
        origin = f"{a} {-d * sin(alpha):.12g} {d * cos(alpha):.12g}"
        parts.append(URDF_JOINT.format(i, i + 1, origin, alpha, *limits[i]))
    return (
        '<?xml version="1.0"?><robot name="fr3">'
        + "".join(parts)
        + URDF_FLANGE.format(FLANGE_m)
        + "</robot>"
    )
