"""The stand-in arm with faults by name: ``python -m benchmarks.trust.hostile_arm 127.0.0.2``.

Nothing here was ever run on hardware. Each entry says where the fault comes from:

* ``DOCUMENTED``: Franka's manuals, headers or published client name it as something the robot does.
* ``REPORTED``: users of real robots have written of it in public.
* ``INVENTED``: no source; what a broken cable or clock might do, and a client has to survive it.

A fault is begun by ``{"do": "fault", "name": NAME}`` on standard input and taken back by the name
``none``. What has happened stays so: a dropped connection, a reflex, an object that slipped out.
One fault at a time.

Faults of the states corrupt what is sent, never the arm: ``describe()`` says where it really is.
Where the client can't answer (``starve``), the stand-in doesn't wait for it and drives the arm by
the last torque at 1 kHz. A real arm stops after 20 lost packets; the order ``miss_rule`` makes this
one do so too.
"""

import argparse
import random
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uniforce_robots.fr3 import DQ_MAX_rad_s, rotation_z
from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.__main__ import main
from uniforce_robots.standins.fci.arm import TICK_s
from uniforce_robots.standins.fci.arm_service import ArmService
from uniforce_robots.standins.fci.hand import HandService, HOMING_SPEED_m_s
from uniforce_robots.standins.fci.link import Journal
from uniforce_robots.standins.fci.process import StandIn
from uniforce_robots.standins.fci.protocol import STATE_SLICES, ErrorBit, RobotState
from uniforce_robots.standins.fci.server import Server, die

NONE = "none"
STATE_BYTES, HAND_STATE_BYTES = p.STATE.size, p.HAND_STATE.size
DOCUMENTED, REPORTED, INVENTED = "documented", "reported", "invented"
GARBAGE_BYTES = (1, 200)  # of what stands for an answer
MEASURED = ("O_T_EE", "q", "dq", "theta", "dtheta")
FORCES = ("tau_ext_hat_filtered", "O_F_ext_hat_K", "K_F_ext_hat_K")
JUMP_rad = 0.3  # about the first joint's axis: 0.1 m at the hand
BEYOND = 10.0  # × the joints' speed limits
FLOOD = 5  # old states a millisecond
NO_STATE_BYTES = (0, 1, 8, HAND_STATE_BYTES - 1, STATE_BYTES - 1, STATE_BYTES + 1, 4000)
SOURCE = random.Random(0)
KEPT = 200  # states sent, for faults that send them again
MIDWAY_s = 0.05  # a command of the hand is under way for
MOVING_m_s = 0.002  # of the tool; below both the arm is at rest
MOVING_rad_s = 0.02
LOOK_s = 1 / 30  # between two looks


class Babble(p.Header):
    """A header in whose place, and its message's, random bytes are sent."""

    def encode(self, message: p.Message) -> bytes:
        return SOURCE.randbytes(SOURCE.randint(*GARBAGE_BYTES))


class HostileArm(ArmService):
    """An arm whose wire can be broken, and that remembers when it moved."""

    def __init__(self, address: str, version: int, journal: Journal) -> None:
        super().__init__(address, version, journal)
        self.sent: deque[RobotState] = deque(maxlen=KEPT)  # the newest, until a fault
        # the tool was faster than 2 mm/s or 0.02 rad/s; None: never
        self.last_moving_ms: int | None = None
        self.mend()

    def mend(self) -> None:
        """Take back every fault of the wire.

        ``outgoing`` turns a state into datagrams. ``starved``: the client can't know of a tick, so
        none waits for it. ``takes_commands``: whether commands arrive.
        """
        self.outgoing: Callable[[RobotState], Iterable[bytes]] | None = None
        self.starved, self.takes_commands = False, True
        self.link.header = p.ARM_HEADER

    def receive_command(self, datagram: bytes) -> None:
        if self.takes_commands:
            super().receive_command(datagram)

    def is_due(self, now_s: float) -> bool:
        return super().is_due(now_s) or (self.starved and now_s - self.sent_s >= TICK_s)

    def tick(self) -> None:
        super().tick()
        twist = self.arm.twist
        if twist[:3] @ twist[:3] > MOVING_m_s**2 or twist[3:] @ twist[3:] > MOVING_rad_s**2:
            self.last_moving_ms = self.milliseconds

    def send(self, state: RobotState) -> None:
        if self.outgoing is None:
            self.sent.append(state)
            super().send(state)
            return
        for datagram in self.outgoing(state):
            self.link.send_state(datagram)

    def newest(self) -> RobotState:
        """Return the newest state that was sent without a fault; one of now if there is none."""
        return self.sent[-1] if self.sent else self.state()

    def describe(self) -> dict[str, object]:
        """Add when the arm moved last, and since when it is at rest (None while it moves)."""
        last = self.last_moving_ms
        held_ms: int | None = 0
        if last is not None:
            held_ms = last + 1 if last < self.milliseconds else None
        return super().describe() | {"last_moving_ms": last, "held_since_ms": held_ms}


class HostileHand(HandService):
    """A hand whose wire can be broken."""

    def __init__(self, address: str, journal: Journal) -> None:
        super().__init__(address, journal)
        self._begun_s = 0.0
        # CLOCK_MONOTONIC, when a fault that waits for its moment came
        self.struck_s: float | None = None
        self.mend()

    def mend(self) -> None:
        """Take back every fault of the wire.

        ``outgoing`` turns a state into datagrams. ``hung``: the fingers stand still and no command
        is answered.
        """
        self.outgoing: Callable[[p.HandState], Iterable[bytes]] | None = None
        self.hung = False
        self.link.header = p.HAND_HEADER

    @property
    def is_midway(self) -> bool:
        """Whether a command has been under way for a while and is not done."""
        return self.pending is not None and time.monotonic() - self._begun_s > MIDWAY_s

    def begin(self, message: p.Message, request: p.Grasp | p.HandMove | None) -> None:
        super().begin(message, request)
        self._begun_s = time.monotonic()

    def answer(self, message: p.Message) -> None:
        if not self.hung or message.command == p.HandCommand.CONNECT:
            super().answer(message)

    def tick(self, now_s: float) -> None:
        if self.hung:
            self.last_tick_s = now_s
        super().tick(now_s)

    def send(self, state: p.HandState) -> None:
        for datagram in [state.encode()] if self.outgoing is None else self.outgoing(state):
            self.link.send_state(datagram)

    def describe(self) -> dict[str, object]:
        return super().describe() | {"struck_s": self.struck_s}


Act = Callable[[HostileArm, HostileHand], None]
Change = Callable[[np.ndarray], None]  # of a state's floats, in place


@dataclass(frozen=True)
class Fault:
    """One way to be broken."""

    does: str  # one line
    source: str  # DOCUMENTED, REPORTED or INVENTED
    begin: Act = lambda arm, hand: None  # what happens at once
    watch: Act = lambda arm, hand: None  # what happens each millisecond while the fault lasts
    end: Act = lambda arm, hand: None  # what has to be taken back beside the wire


# --- the arm's states ---


def corrupt(change: Change) -> Act:
    """Return what changes the numbers of each state sent; the arm's own stay as they are."""

    def changed(state: RobotState) -> Iterable[bytes]:
        floats = state.floats.copy()
        change(floats)
        yield replace(state, floats=floats).encode()

    return lambda arm, _: setattr(arm, "outgoing", changed)


def fill(values: Mapping[str, np.ndarray | float]) -> Change:
    def change(floats: np.ndarray) -> None:
        for name, value in values.items():
            floats[STATE_SLICES[name]] = value

    return change


def turn(floats: np.ndarray) -> None:
    """Turn the first joint by 0.3 rad at once, and the hand with it."""
    floats[STATE_SLICES["q"].start] += JUMP_rad
    floats[STATE_SLICES["theta"].start] += JUMP_rad
    pose = floats[STATE_SLICES["O_T_EE"]].reshape(4, 4).T
    floats[STATE_SLICES["O_T_EE"]] = (rotation_z(JUMP_rad) @ pose).T.ravel()


def freeze(arm: HostileArm, hand: HostileHand) -> None:
    """Send the same pose from now on, at the time that it is."""
    last = arm.newest()
    kept = {name: last[name].copy() for name in (*MEASURED, "O_dP_EE_d", "O_dP_EE_c")}
    corrupt(fill(kept))(arm, hand)


def starve(datagrams: Callable[[], Iterable[bytes]]) -> Act:
    """Return what leaves a client without a state it can answer."""

    def begin(arm: HostileArm, hand: HostileHand) -> None:
        arm.outgoing, arm.starved = lambda _: datagrams(), True

    return begin


def stop_clock(arm: HostileArm, hand: HostileHand) -> None:
    newest = arm.newest().encode()
    starve(lambda: [newest])(arm, hand)


def send_old(arm: HostileArm, hand: HostileHand) -> None:
    """Send what was sent before, in any order and several each millisecond."""
    sent = [state.encode() for state in (*arm.sent, arm.newest())]
    starve(lambda: SOURCE.choices(sent, k=FLOOD))(arm, hand)


# --- connections ---


def babble(service: HostileArm | HostileHand) -> None:
    header = service.link.header
    service.link.header = Babble(header.layout, header.device)
    service.link.send_bytes(service.link.header.encode(p.Message(0, 0)))


def drop(service: HostileArm | HostileHand) -> None:
    service.link.drop("fault")
    service.client_gone()


def lose_commands(arm: HostileArm, hand: HostileHand) -> None:
    """Let no command arrive, so that the arm counts them as missed."""
    arm.takes_commands, arm.miss_rule = False, True


def end_misses(arm: HostileArm, hand: HostileHand) -> None:
    """Count missed commands no longer."""
    arm.miss_rule = False


def reflex(bit: ErrorBit) -> Act:
    return lambda arm, _: arm.reflex(frozenset({bit}))


# --- the hand ---


def hand_sends(datagrams: Callable[[], Iterable[bytes]]) -> Act:
    return lambda _, hand: setattr(hand, "outgoing", lambda _: datagrams())


def lose_width(arm: HostileArm, hand: HostileHand) -> None:
    hand.outgoing = lambda state: [state._replace(width_m=float("nan")).encode()]


def drop_hand_midway(arm: HostileArm, hand: HostileHand) -> None:
    """Close the hand's connection once a command is under way."""
    if hand.is_midway:
        hand.struck_s = time.monotonic()
        drop(hand)


def hang_hand(arm: HostileArm, hand: HostileHand) -> None:
    if hand.is_midway and not hand.hung:
        hand.hung, hand.struck_s = True, time.monotonic()


def slip(arm: HostileArm, hand: HostileHand) -> None:
    if hand.hand.is_grasped:
        hand.struck_s = time.monotonic()
        hand.hand.object_m = 0.0
        hand.hand.start(p.HandMove(0.0, HOMING_SPEED_m_s))  # the fingers close on nothing


def all_are(names: Iterable[str], value: float) -> Act:
    """Return what sends one value in place of every number of these fields."""
    return corrupt(fill(dict.fromkeys(names, value)))


TORQUE_STEP = reflex(ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY)
FAST = corrupt(fill(dict.fromkeys(("dq", "dtheta"), BEYOND * DQ_MAX_rad_s)))
GARBAGE = starve(lambda: [SOURCE.randbytes(STATE_BYTES)])
WRONG_LENGTH = starve(lambda: [SOURCE.randbytes(SOURCE.choice(NO_STATE_BYTES))])
HAND_GARBAGE = hand_sends(lambda: [SOURCE.randbytes(HAND_STATE_BYTES)])
_nan, _inf = float("nan"), float("inf")

FAULTS = {
    # the arm's states
    "nan_state": Fault("pose, joints, speeds are NaN", INVENTED, all_are(MEASURED, _nan)),
    "inf_state": Fault("pose, joints, speeds are inf", INVENTED, all_are(MEASURED, _inf)),
    "nan_force": Fault("force estimates are NaN", INVENTED, all_are(FORCES, _nan)),
    "pose_jump": Fault("joint 1 jumps by 0.3 rad, the pose with it", INVENTED, corrupt(turn)),
    "velocity_beyond_physics": Fault("joints at 10 × their fastest", INVENTED, FAST),
    "frozen_state": Fault("time goes on, pose and joints stay", INVENTED, freeze),
    "stopped_clock": Fault("the same state again and again", INVENTED, stop_clock),
    "state_flood_old": Fault("old states only, in any order, 5 a ms", INVENTED, send_old),
    "silent_arm": Fault("no states; TCP stays open", REPORTED, starve(lambda: ())),
    "garbage_state": Fault("random bytes of a state's length", INVENTED, GARBAGE),
    "wrong_length_state": Fault("0 to 4000 random bytes", INVENTED, WRONG_LENGTH),
    # the arm's connection
    "lost_commands": Fault(
        "no command arrives; 20 end a motion", DOCUMENTED, lose_commands, end=end_misses
    ),
    "arm_garbage_reply": Fault(
        "random bytes on the arm's TCP", INVENTED, lambda arm, _: babble(arm)
    ),
    "arm_dropped": Fault("the arm closes its TCP connection", REPORTED, lambda arm, _: drop(arm)),
    "server_death": Fault("the process ends; every socket closes", INVENTED, lambda arm, _: die()),
    # what stops a real arm
    "user_stop": Fault(
        "the user stop", DOCUMENTED, lambda a, _: a.user_stop(), end=lambda a, _: a.release()
    ),
    "reflex": Fault("a collision at the hand", DOCUMENTED, reflex(ErrorBit.CARTESIAN_REFLEX)),
    "joint_reflex": Fault("a collision at a joint", DOCUMENTED, reflex(ErrorBit.JOINT_REFLEX)),
    "torque_discontinuity": Fault("a torque step above 1 Nm/ms", DOCUMENTED, TORQUE_STEP),
    "joint_velocity": Fault(
        "a joint too fast", DOCUMENTED, reflex(ErrorBit.JOINT_VELOCITY_VIOLATION)
    ),
    "cartesian_velocity": Fault(
        "a hand too fast", DOCUMENTED, reflex(ErrorBit.CARTESIAN_VELOCITY_VIOLATION)
    ),
    "joint_limit": Fault(
        "a joint's end", DOCUMENTED, reflex(ErrorBit.JOINT_POSITION_LIMITS_VIOLATION)
    ),
    "power_limit": Fault("too much power", DOCUMENTED, reflex(ErrorBit.POWER_LIMIT_VIOLATION)),
    # the hand
    "hung_hand": Fault(
        "fingers stop midway, no answer any more; states go on", REPORTED, watch=hang_hand
    ),
    "hand_silent": Fault("no states; TCP stays open", INVENTED, hand_sends(lambda: ())),
    "hand_dropped": Fault(
        "the hand closes its TCP connection", INVENTED, lambda _, hand: drop(hand)
    ),
    "hand_dropped_midway": Fault("the same, within a command", INVENTED, watch=drop_hand_midway),
    "hand_garbage_state": Fault("random bytes of a state's length", INVENTED, HAND_GARBAGE),
    "nan_width": Fault("the width is NaN", INVENTED, lose_width),
    "hand_garbage_reply": Fault(
        "random bytes on the hand's TCP", INVENTED, lambda _, hand: babble(hand)
    ),
    "slip_out": Fault("what is held slips out; the fingers close", DOCUMENTED, watch=slip),
}


class Faults:
    """One fault at a time, from one order to the next."""

    def __init__(self, arm: HostileArm, hand: HostileHand, journal: Journal) -> None:
        self.arm, self.hand, self.journal = arm, hand, journal
        self.name = NONE  # the one that lasts
        self._last: dict[str, object] = {"last": NONE, "at_ms": None, "at_s": None}

    def order(self, name: str) -> None:
        """End the fault that lasts, and begin another; ValueError: no such fault."""
        if name != NONE and name not in FAULTS:
            raise ValueError(f"fault: expected {NONE} or one of {sorted(FAULTS)}, got {name!r}")
        self._end()
        if name != NONE:
            now_ms, self.name = self.arm.milliseconds, name
            self._last = {"last": name, "at_ms": now_ms, "at_s": time.monotonic()}
            self.journal.write("fault", name=name, milliseconds=now_ms)
            FAULTS[name].begin(self.arm, self.hand)

    def tick(self) -> None:
        if self.name != NONE:
            FAULTS[self.name].watch(self.arm, self.hand)

    def describe(self) -> dict[str, object]:
        """Return the fault that lasts, and when the last began: robot's time, CLOCK_MONOTONIC."""
        return {"name": self.name, **self._last}

    def _end(self) -> None:
        if self.name == NONE:
            return
        fault, self.name = FAULTS[self.name], NONE
        self.arm.mend()
        self.hand.mend()
        fault.end(self.arm, self.hand)
        self.journal.write("fault", name=NONE, milliseconds=self.arm.milliseconds)


class HostileServer(Server):
    """The stand-in that obeys ``fault`` as well, and shows what lasts."""

    arm_service, hand_service = HostileArm, HostileHand
    arm: HostileArm
    hand: HostileHand

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options)
        self.faults = Faults(self.arm, self.hand, self.journal)
        self.orders["fault"] = self.faults.order

    def tick(self) -> None:
        super().tick()
        self.faults.tick()

    def describe(self) -> dict[str, object]:
        return super().describe() | {"fault": self.faults.describe()}


class HostileStandIn(StandIn):
    """A running ``HostileServer``; ``do("fault", name=…)`` breaks it."""

    module = "benchmarks.trust.hostile_arm"

    def look_after(self, for_s: float) -> dict[str, Any]:
        """Return what it shows once its own clock, slow on a busy machine, went on by ``for_s``."""
        end_ms = self.do("look")["arm"]["milliseconds"] + 1e3 * for_s
        while (look := self.do("look"))["arm"]["milliseconds"] < end_ms:
            time.sleep(LOOK_s)
        return look


if __name__ == "__main__":
    main(HostileServer)
