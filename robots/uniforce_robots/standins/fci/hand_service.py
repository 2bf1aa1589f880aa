"""The hand's side of the wire: requests answered when the fingers have arrived, states at the hand's slow rate."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from uniforce_robots.standins.fci.hand import Hand
from uniforce_robots.standins.fci.journal import Journal
from uniforce_robots.standins.fci.link import Link
from uniforce_robots.standins.fci.protocol import (
    HAND_HEADER,
    HAND_PORT,
    HAND_VERSION,
    ConnectRequest,
    ConnectStatus,
    GraspRequest,
    HandCommand,
    HandMoveRequest,
    HandState,
    HandStatus,
    Message,
    ProtocolError,
)

REST_C = 30  # temperature of a hand that is not there
MIDWAY_s = 0.05  # a command is under way for


def whole(state: HandState) -> Iterable[bytes]:
    """Yield a state as it is: what a hand without a fault sends."""
    yield state.encode()


@dataclass(frozen=True)
class HandOptions:
    """How the hand behaves on the wire. The real one tells its state about ten times a second."""

    version: int = HAND_VERSION
    state_hz: float = 10.0


class HandService:
    """A hand behind its port."""

    def __init__(self, address: str, options: HandOptions, journal: Journal) -> None:
        self.link = Link(address, HAND_PORT, HAND_HEADER, journal)
        self.options, self.journal = options, journal
        self.state_hz = options.state_hz
        self.hand = Hand()
        self._pending: Message | None = None
        self._states = 0
        self._begun_s = 0.0
        self.struck_s: float | None = None  # CLOCK_MONOTONIC, when a fault that waits for its moment came
        self.mend()
        self._next_state_s = self._last_tick_s = time.monotonic()

    def mend(self) -> None:
        """Take back every fault of the wire.

        ``outgoing`` turns a state into datagrams. ``hung``: the fingers stand still and no command is answered.
        """
        self.outgoing: Callable[[HandState], Iterable[bytes]] = whole
        self.hung = False
        self.link.garbage = None

    @property
    def is_midway(self) -> bool:
        """Whether a command has been under way for a while and is not done."""
        return self._pending is not None and time.monotonic() - self._begun_s > MIDWAY_s

    def handle(self, message: Message) -> None:
        """Answer one request, or remember it until the fingers arrive."""
        name = HandCommand(message.command).name if message.command in list(HandCommand) else "?"
        details = {"command": name, "command_id": message.command_id, "busy": self._pending is not None}
        size = HAND_HEADER.layout.size + len(message.payload)
        self.journal.write("request", device="hand", bytes=size, **details)
        if self.hung and message.command != HandCommand.CONNECT:
            return
        try:
            self._dispatch(message)
        except ProtocolError as error:
            self.link.drop(str(error))
            self.client_gone()

    def _dispatch(self, message: Message) -> None:
        match message.command:
            case HandCommand.CONNECT:
                self._connect(message)
            case HandCommand.STOP:
                self._abort()
                self._reply(message, HandStatus.SUCCESS)
            case HandCommand.HOMING:
                self._abort()
                self.hand.start_homing()
                self._await(message)
            case HandCommand.MOVE:
                self._begin(message, HandMoveRequest.decode(message.payload))
            case HandCommand.GRASP:
                self._begin(message, GraspRequest.decode(message.payload))
            case _:
                raise ProtocolError("hand command", "0 to 4", message.command)

    def _connect(self, message: Message) -> None:
        request = ConnectRequest.decode(message.payload)
        fits = request.version == self.options.version
        status = ConnectStatus.SUCCESS if fits else ConnectStatus.INCOMPATIBLE_VERSION
        self.link.greet(message, request, struct.pack("<HH", status, self.options.version), fits)

    def _begin(self, message: Message, request: HandMoveRequest | GraspRequest) -> None:
        """Start a motion; one that is under way is aborted, which the real hand takes badly."""
        self._abort()
        self.journal.write("hand", request=type(request).__name__, **vars(request))
        if isinstance(request, GraspRequest):
            possible = self.hand.start_grasp(request)
        else:
            possible = self.hand.start_move(request)
        if possible:
            self._await(message)
        else:
            self._reply(message, HandStatus.FAIL)

    def _await(self, message: Message) -> None:
        self._pending, self._begun_s = message, time.monotonic()

    def _abort(self) -> None:
        self.hand.stop()
        if self._pending is not None:
            pending, self._pending = self._pending, None
            self._reply(pending, HandStatus.ABORTED)

    def _reply(self, message: Message, status: HandStatus) -> None:
        self.link.send(Message(message.command, message.command_id, struct.pack("<H", status)))

    def client_gone(self) -> None:
        """Stop when the client has left; there is nobody to answer."""
        self.hand.stop()
        self._pending = None

    def tick(self, now_s: float) -> None:
        """Let time pass, on the wall's clock: the hand waits for no client."""
        outcome = None if self.hung else self.hand.advance(now_s - self._last_tick_s)
        self._last_tick_s = now_s
        if outcome is not None and self._pending is not None:
            pending, self._pending = self._pending, None
            self._reply(pending, outcome)
        if now_s >= self._next_state_s:
            self._next_state_s = now_s + 1 / self.state_hz
            self._send_state()

    def _send_state(self) -> None:
        self._states += 1
        hand = self.hand
        state = HandState(self._states, hand.width_m, hand.max_width_m, hand.is_grasped, REST_C)
        for datagram in self.outgoing(state):
            self.link.send_state(datagram)

    def describe(self) -> dict[str, object]:
        """Return what a test wants to know without a client."""
        hand = self.hand
        shown = {"width_m": hand.width_m, "is_grasped": hand.is_grasped, "force_N": hand.force_N}
        return {**shown, "struck_s": self.struck_s}
