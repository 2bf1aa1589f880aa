"""The arm's control loop: a Move under way, commands taken, a millisecond driven, a state told; and what stops it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from uniforce_robots.standins.fci.arm import Arm
from uniforce_robots.standins.fci.journal import Journal
from uniforce_robots.standins.fci.link import Link
from uniforce_robots.standins.fci.motion import Motion
from uniforce_robots.standins.fci.protocol import (
    ARM_HEADER,
    ARM_PORT,
    ARM_VERSION,
    ArmCommand,
    Controller,
    Message,
    MoveStatus,
    ProtocolError,
    RobotCommand,
    RobotMode,
    RobotState,
)
from uniforce_robots.standins.fci.watch import Watch

KEPT = 200  # states sent, for faults that send them again
SUCCESS_WINDOW = 100  # commands the success rate is about
STOPPED = (RobotMode.REFLEX, RobotMode.USER_STOPPED)


@dataclass(frozen=True)
class ArmOptions:
    """How the arm behaves on the wire.

    Attributes:
        version: what the server says it is; another than 10 refuses every client of version 10.
        patience_s: how long a tick waits for the client's command. Time then passes slower instead of the arm flying
            off on a stale torque, which keeps results the same on a busy machine.
        miss_rule: end a motion after 20 missed commands, as the real arm does. Off by default: a test machine without
            a real-time kernel would be tested, not the client. On, a tick waits 1 ms only.
        rules: end a motion by reflex when a command breaks a limit (``rules.py``), as the real arm does.
    """

    version: int = ARM_VERSION
    patience_s: float = 0.02
    miss_rule: bool = False
    rules: bool = True


def whole(state: RobotState) -> Iterable[bytes]:
    """Yield a state as it is: what an arm without a fault sends."""
    yield state.encode()


class ControlLoop:
    """An arm that a client drives by UDP; requests by TCP are the subclass's."""

    def __init__(self, address: str, options: ArmOptions, journal: Journal) -> None:
        self.link = Link(address, ARM_PORT, ARM_HEADER, journal)
        self.options, self.journal = options, journal
        self.arm = Arm()
        self.mode = RobotMode.IDLE
        self.motion: Motion | None = None
        self.errors: frozenset[int] = frozenset()
        self.reflex_reason: frozenset[int] = frozenset()
        self.success_rate = 0.0
        self.miss_rule, self.rules = options.miss_rule, options.rules
        self.watch = Watch()
        self.mend()
        self.milliseconds = 0
        self._sent_at = 0.0
        self.sent: deque[RobotState] = deque(maxlen=KEPT)  # the newest, until a fault

    def mend(self) -> None:
        """Take back every fault of the wire.

        ``outgoing`` turns a state into datagrams. ``starved``: the client can't know of a tick, so none waits for it.
        ``hears``: whether commands arrive.
        """
        self.outgoing: Callable[[RobotState], Iterable[bytes]] = whole
        self.starved, self.hears = False, True
        self.link.garbage = None

    def end_motion(self, status: MoveStatus, mode: RobotMode = RobotMode.IDLE) -> None:
        """Show the new mode in a state first, then answer the Move: the order clients wait for."""
        motion, self.motion, self.mode = self.motion, None, mode
        self._send_state()
        if motion is not None:
            self.link.send(Message(ArmCommand.MOVE, motion.command_id, bytes([status])))

    def client_gone(self) -> None:
        """Brake when the client has left: there is no one to answer."""
        if self.motion is not None:
            self.journal.write("motion lost its client")
            self.motion, self.mode = None, RobotMode.IDLE

    def receive_command(self, datagram: bytes) -> None:
        """Take a command of the control loop."""
        if not self.hears:
            return
        try:
            command = RobotCommand.decode(datagram)
        except ProtocolError as error:
            self.journal.write("invalid", why=str(error), bytes=len(datagram))
            return
        if self.journal.is_on:
            tau = [round(float(t), 4) for t in command.tau_J_d]
            self.journal.write("command", id=command.message_id, tau_Nm=tau, finished=command.finished)
        self.watch.last_command_ms = self.milliseconds
        if self.motion is not None:
            self.motion.take(command, self.arm, self.milliseconds, self.rules)

    @property
    def _counts_misses(self) -> bool:
        return self.miss_rule or not self.hears

    def is_due(self, now_s: float) -> bool:
        """Whether the next millisecond may begin: the client has answered, or waited too long."""
        if self.motion is None or self.motion.answered:
            return True
        patience = 0.001 if self._counts_misses or self.starved else self.options.patience_s
        return now_s - self._sent_at >= patience

    def tick(self) -> None:
        """Let one millisecond of the robot's time pass and tell of it."""
        if self.motion is not None:
            self._drive(self.motion)
        elif self.mode == RobotMode.GUIDING:
            self.arm.guide()
        else:
            self.arm.hold()
        self.milliseconds += 1
        self.watch.look(self.arm, self.milliseconds)
        self._send_state()

    def _drive(self, motion: Motion) -> None:
        command = motion.command
        if command is None:  # the client has not begun
            self.arm.hold()
            return
        self._count(motion)
        violations = motion.broken or self._follow(motion, command)
        if violations:
            self.reflex(violations)
        elif command.finished:
            self.end_motion(MoveStatus.SUCCESS)

    def _follow(self, motion: Motion, command: RobotCommand) -> frozenset[int]:
        """Drive the arm for a millisecond; return the error bits that end the motion."""
        self.arm.drive(command, motion.request.generator)
        return self.arm.violations() | motion.lost(self._counts_misses)

    def _count(self, motion: Motion) -> None:
        motion.count()
        self.success_rate += (float(motion.answered) - self.success_rate) / SUCCESS_WINDOW
        motion.answered = False

    def _send_state(self) -> None:
        self._sent_at = time.monotonic()
        state = self._state()
        if self.journal.is_on:
            position = [round(float(x), 6) for x in self.arm.ee_to_base[:3, 3]]
            self.journal.write("state", id=state.message_id, mode=self.mode.name, position_m=position)
        if self.outgoing is whole:
            self.sent.append(state)
        for datagram in self.outgoing(state):
            self.link.send_state(datagram)

    def newest(self) -> RobotState:
        """Return the newest state that was sent without a fault; one of now if there is none."""
        return self.sent[-1] if self.sent else self._state()

    def _state(self) -> RobotState:
        request = self.motion.request if self.motion else None
        return RobotState(
            self.milliseconds,
            self.arm.state_floats(),
            request.generator + 1 if request else 0,
            request.controller if request else Controller.OTHER,
            self.errors,
            self.reflex_reason,
            self.mode,
            self.success_rate if request else 0.0,
        )

    # --- faults ------------------------------------------------------------------------------------------------------

    def reflex(self, errors: frozenset[int]) -> None:
        """Stop by reflex; motion is refused until recovery."""
        self.errors = self.reflex_reason = frozenset(errors)
        self.journal.write("reflex", errors=sorted(int(e) for e in errors))
        self.end_motion(MoveStatus.REFLEX_ABORTED, RobotMode.REFLEX)

    def user_stop(self) -> None:
        """Press the stop button."""
        self.journal.write("user stop")
        self.end_motion(MoveStatus.EMERGENCY_ABORTED, RobotMode.USER_STOPPED)

    def release(self) -> None:
        """Let go of the stop button or of the guiding buttons."""
        if self.mode in (RobotMode.USER_STOPPED, RobotMode.GUIDING):
            self.mode = RobotMode.IDLE

    def guide(self) -> None:
        """Press the guiding buttons at the flange."""
        self.journal.write("guiding")
        if self.mode not in STOPPED:
            self.end_motion(MoveStatus.ABORTED, RobotMode.GUIDING)

    def describe(self) -> dict[str, object]:
        """Return what a test wants to know without a client."""
        return {
            "milliseconds": self.milliseconds,
            "mode": self.mode.name,
            "moving": self.motion is not None,
            **self.arm.describe(),
            **self.watch.describe(self.milliseconds),
            "errors": sorted(int(e) for e in self.errors),
        }
