"""The hand: how its fingers move, and its side of the wire: late answers, slow states."""

import struct
import time

from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.link import Journal, Link

MAX_WIDTH_m = 0.08
HOMING_SPEED_m_s = 0.1
ARRIVED_m = 1e-6
STATE_HZ = 10.0  # about what the real one gives
REST_C = 30  # temperature of a hand that is not there


class Hand:
    """Two fingers and an object between them; ``start`` a motion, ``advance`` until it ends."""

    def __init__(self) -> None:
        self.width_m = MAX_WIDTH_m
        self.object_m = 0.0  # width of what stands between the fingers; 0: nothing
        self.force_N = 0.0  # of the last grasp that held
        self.is_grasped = self._homing = False
        self._goal_m: float | None = None
        self._speed_m_s = 0.0
        self._grasp: p.Grasp | None = None

    def start(self, request: p.Grasp | p.HandMove | None) -> bool:
        """Begin to grasp, to go to a width, or (None) to home; return whether it is possible.

        Homing closes and opens fully, which measures the widest opening.
        """
        if request is None:
            self._begin(0.0, HOMING_SPEED_m_s)
            self._homing = True
            return True
        grasp = request if isinstance(request, p.Grasp) else None
        if not (0 <= request.width_m <= MAX_WIDTH_m and request.speed_m_s > 0):
            return False
        if grasp is not None and not grasp.force_N > 0:
            return False
        self._begin(0.0 if grasp else request.width_m, request.speed_m_s)
        self._grasp = grasp
        return True

    def stop(self) -> None:
        """Stop where the fingers are."""
        self._goal_m = None
        self._grasp = None
        self._homing = False

    def _begin(self, goal_m: float, speed_m_s: float) -> None:
        self.stop()
        self._goal_m = goal_m
        self._speed_m_s = speed_m_s
        self.is_grasped = False
        self.force_N = 0.0

    def advance(self, dt_s: float) -> p.HandStatus | None:
        """Move for ``dt_s``; return the motion's outcome when it ends, None otherwise."""
        if self._goal_m is None:
            return None
        step = self._speed_m_s * dt_s
        goal = self._goal_m
        if self.width_m >= self.object_m - ARRIVED_m:
            goal = max(goal, self.object_m)
        self.width_m += min(max(goal - self.width_m, -step), step)
        if abs(self.width_m - goal) > ARRIVED_m:
            return None
        return self._arrive(self._goal_m)

    def _arrive(self, goal_m: float) -> p.HandStatus | None:
        if self._homing and goal_m == 0.0:
            self._goal_m = MAX_WIDTH_m  # the way back
            return None
        grasp = self._grasp
        self.stop()
        if grasp is None:
            succeeds = abs(goal_m - self.width_m) < ARRIVED_m
        else:
            touches = self.object_m > 0 and self.width_m <= self.object_m + ARRIVED_m
            inside = grasp.width_m - grasp.inner_m < self.width_m < grasp.width_m + grasp.outer_m
            succeeds = self.is_grasped = touches and inside
            self.force_N = grasp.force_N if succeeds else 0.0
        return p.HandStatus.SUCCESS if succeeds else p.HandStatus.UNSUCCESSFUL


class HandService:
    """A hand behind its port."""

    def __init__(self, address: str, journal: Journal) -> None:
        self.link = Link(address, p.HAND_PORT, p.HAND_HEADER, journal)
        self.hand = Hand()
        # what is to be answered when the fingers have arrived
        self.pending: p.Message | None = None
        self._states = 0
        self._next_state_s = self.last_tick_s = time.monotonic()

    def answer(self, message: p.Message) -> None:
        """Answer a request now or when the fingers arrive; ProtocolError: it can't be read."""
        self.link.write_request(message, p.HandCommand, busy=self.pending is not None)
        match message.command:
            case p.HandCommand.CONNECT:
                self.link.greet(message, p.HAND_VERSION, struct.Struct("<HH").pack)
            case p.HandCommand.STOP:
                self._abort()
                self._reply(message, p.HandStatus.SUCCESS)
            case p.HandCommand.HOMING:
                self.begin(message, None)
            case p.HandCommand.MOVE:
                self.begin(message, p.decode_hand(p.HandMove, message.payload))
            case p.HandCommand.GRASP:
                self.begin(message, p.decode_hand(p.Grasp, message.payload))
            case _:
                raise p.ProtocolError("hand command", "0 to 4", message.command)

    def begin(self, message: p.Message, request: p.Grasp | p.HandMove | None) -> None:
        """Start a motion; one that is under way is aborted, which the real hand takes badly."""
        self._abort()
        if request is not None:
            self.link.journal.write("hand", request=type(request).__name__, **request._asdict())
        if self.hand.start(request):
            self.pending = message
        else:
            self._reply(message, p.HandStatus.FAIL)

    def _abort(self) -> None:
        self.hand.stop()
        self._end(p.HandStatus.ABORTED)

    def _end(self, status: p.HandStatus) -> None:
        pending = self.pending
        self.pending = None
        if pending is not None:
            self._reply(pending, status)

    def _reply(self, message: p.Message, status: p.HandStatus) -> None:
        self.link.reply(message, struct.pack("<H", status))

    def client_gone(self) -> None:
        """Stop when the client has left; no answer is sent."""
        self.hand.stop()
        self.pending = None

    def tick(self, now_s: float) -> None:
        """Let time pass, on the wall's clock: the hand waits for no client."""
        outcome = self.hand.advance(now_s - self.last_tick_s)
        self.last_tick_s = now_s
        if outcome is not None:
            self._end(outcome)
        if now_s >= self._next_state_s:
            self._next_state_s = now_s + 1 / STATE_HZ
            self._states += 1
            self.send(
                p.HandState(
                    self._states, self.hand.width_m, MAX_WIDTH_m, self.hand.is_grasped, REST_C
                )
            )

    def send(self, state: p.HandState) -> None:
        """Send a state to the client."""
        self.link.send_state(state.encode())

    def describe(self) -> dict[str, object]:
        """Return what a test wants to know without a client."""
        hand = self.hand
        return {"width_m": hand.width_m, "is_grasped": hand.is_grasped, "force_N": hand.force_N}
