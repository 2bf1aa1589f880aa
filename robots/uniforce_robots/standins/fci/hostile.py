"""Every fault the stand-in can be ordered to have, by name.

Nothing here was ever run on hardware. Each entry says where the fault comes from:

* ``DOCUMENTED``: Franka's manuals, headers or published client name it as something the robot does.
* ``REPORTED``: users of real robots have written of it in public.
* ``INVENTED``: no source; what a broken cable, memory or clock might do, and a client has to survive it.

A fault is begun by ``{"do": "fault", "name": NAME}`` on the control socket and taken back by the name ``none``. What
has happened stays so: a dropped connection, a reflex, an object that slipped out. One fault at a time.

Faults of the states corrupt what is sent, never the arm: ``describe()`` says where it really is. Where the client
can't answer (``starve``), the stand-in doesn't wait for it and drives the arm by the last torque at 1 kHz. A real arm
stops after 20 lost packets; the order ``miss_rule`` makes this one do so too.
"""

import os
import random
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from uniforce_robots.fr3 import DQ_MAX_rad_s, rotation_z
from uniforce_robots.standins.fci.arm_service import ArmService
from uniforce_robots.standins.fci.hand import HandService
from uniforce_robots.standins.fci.link import Journal
from uniforce_robots.standins.fci.protocol import (
    HAND_STATE_BYTES,
    STATE_BYTES,
    STATE_SLICES,
    ErrorBit,
    RobotState,
)

NONE = "none"
DIED = 9  # exit code of the death a test asked for
DOCUMENTED, REPORTED, INVENTED = "documented", "reported", "invented"
GARBAGE_BYTES = (1, 200)  # of what stands for an answer
MEASURED = ("O_T_EE", "q", "dq", "theta", "dtheta")
FORCES = ("tau_ext_hat_filtered", "O_F_ext_hat_K", "K_F_ext_hat_K")
JUMP_rad = 0.3  # about the first joint's axis: 0.1 m at the hand
BEYOND = 10.0  # × the joints' speed limits
FLOOD = 5  # old states a millisecond
NO_STATE_BYTES = (0, 1, 8, HAND_STATE_BYTES - 1, STATE_BYTES - 1, STATE_BYTES + 1, 4000)
SOURCE = random.Random(0)

Act = Callable[[ArmService, HandService], None]
Change = Callable[[np.ndarray], None]  # of a state's floats, in place


@dataclass(frozen=True)
class Fault:
    """One way to be broken."""

    does: str  # one line
    source: str  # DOCUMENTED, REPORTED or INVENTED
    begin: Act = lambda arm, hand: None  # what happens at once
    watch: Act = lambda arm, hand: None  # what happens each millisecond while the fault lasts
    end: Act = lambda arm, hand: None  # what has to be taken back beside the wire


# --- the arm's states ------------------------------------------------------------------------------------------------


def corrupt(change: Change) -> Act:
    """Return what changes the numbers of each state that is sent; the arm's own stay as they are."""

    def changed(state: RobotState) -> Iterable[bytes]:
        floats = state.floats.copy()
        change(floats)
        yield replace(state, floats=floats).encode()

    return lambda arm, _: setattr(arm, "outgoing", changed)


def fill(values: Mapping[str, np.ndarray | float]) -> Change:
    """Return what replaces these fields."""

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


def freeze(arm: ArmService, hand: HandService) -> None:
    """Send the same pose from now on, at the time that it is."""
    last = arm.newest()
    kept = {name: last[name].copy() for name in (*MEASURED, "O_dP_EE_d", "O_dP_EE_c")}
    corrupt(fill(kept))(arm, hand)


def starve(datagrams: Callable[[], Iterable[bytes]]) -> Act:
    """Return what leaves a client without a state it can answer."""

    def begin(arm: ArmService, hand: HandService) -> None:
        arm.outgoing, arm.starved = lambda _: datagrams(), True

    return begin


def stop_clock(arm: ArmService, hand: HandService) -> None:
    """Send the newest state again and again."""
    newest = arm.newest().encode()
    starve(lambda: [newest])(arm, hand)


def send_old(arm: ArmService, hand: HandService) -> None:
    """Send what was sent before, in any order and several each millisecond."""
    sent = [state.encode() for state in (*arm.sent, arm.newest())]
    starve(lambda: SOURCE.choices(sent, k=FLOOD))(arm, hand)


# --- connections -----------------------------------------------------------------------------------------------------


def babble(service: ArmService | HandService) -> None:
    """Send random bytes at once, and in place of every answer."""
    service.link.garbage = lambda: SOURCE.randbytes(SOURCE.randint(*GARBAGE_BYTES))
    service.link.send_bytes(service.link.garbage())


def drop(service: ArmService | HandService) -> None:
    """Close the connection."""
    service.link.drop("fault")
    service.client_gone()


def lose_commands(arm: ArmService, hand: HandService) -> None:
    """Let no command arrive."""
    arm.takes_commands = False


def die(arm: ArmService, hand: HandService) -> None:
    """End the process without a word to its clients."""
    arm.journal.flush()
    os._exit(DIED)


def reflex(bit: ErrorBit) -> Act:
    """Return what stops the arm by reflex for this reason."""
    return lambda arm, _: arm.reflex(frozenset({bit}))


# --- the hand --------------------------------------------------------------------------------------------------------


def hand_sends(datagrams: Callable[[], Iterable[bytes]]) -> Act:
    """Return what is sent in place of each of the hand's states."""
    return lambda _, hand: setattr(hand, "outgoing", lambda _: datagrams())


def lose_width(arm: ArmService, hand: HandService) -> None:
    """Send a width that is no number."""
    hand.outgoing = lambda state: [state._replace(width_m=float("nan")).encode()]


def drop_hand_midway(arm: ArmService, hand: HandService) -> None:
    """Close the hand's connection once a command is under way."""
    if hand.is_midway:
        hand.struck_s = time.monotonic()
        drop(hand)


def hang_hand(arm: ArmService, hand: HandService) -> None:
    """Stop the fingers once a command is under way."""
    if hand.is_midway and not hand.hung:
        hand.hung, hand.struck_s = True, time.monotonic()


def slip(arm: ArmService, hand: HandService) -> None:
    """Lose what is held."""
    if hand.hand.is_grasped:
        hand.struck_s = time.monotonic()
        hand.hand.slip()


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
    "lost_commands": Fault("no command arrives; 20 in a row end a motion", DOCUMENTED, lose_commands),
    "arm_garbage_reply": Fault("random bytes on the arm's TCP", INVENTED, lambda arm, _: babble(arm)),
    "arm_dropped": Fault("the arm closes its TCP connection", REPORTED, lambda arm, _: drop(arm)),
    "server_death": Fault("the process ends; every socket closes", INVENTED, die),
    # what stops a real arm
    "user_stop": Fault("the user stop", DOCUMENTED, lambda a, _: a.user_stop(), end=lambda a, _: a.release()),
    "reflex": Fault("a collision at the hand", DOCUMENTED, reflex(ErrorBit.CARTESIAN_REFLEX)),
    "joint_reflex": Fault("a collision at a joint", DOCUMENTED, reflex(ErrorBit.JOINT_REFLEX)),
    "torque_discontinuity": Fault("a torque step above 1 Nm/ms", DOCUMENTED, TORQUE_STEP),
    "joint_velocity": Fault("a joint too fast", DOCUMENTED, reflex(ErrorBit.JOINT_VELOCITY_VIOLATION)),
    "cartesian_velocity": Fault("a hand too fast", DOCUMENTED, reflex(ErrorBit.CARTESIAN_VELOCITY_VIOLATION)),
    "joint_limit": Fault("a joint's end", DOCUMENTED, reflex(ErrorBit.JOINT_POSITION_LIMITS_VIOLATION)),
    "power_limit": Fault("too much power", DOCUMENTED, reflex(ErrorBit.POWER_LIMIT_VIOLATION)),
    # the hand
    "hung_hand": Fault("fingers stop midway, no answer any more; states go on", REPORTED, watch=hang_hand),
    "hand_silent": Fault("no states; TCP stays open", INVENTED, hand_sends(lambda: ())),
    "hand_dropped": Fault("the hand closes its TCP connection", INVENTED, lambda _, hand: drop(hand)),
    "hand_dropped_midway": Fault("the same, within a command", INVENTED, watch=drop_hand_midway),
    "hand_garbage_state": Fault("random bytes of a state's length", INVENTED, HAND_GARBAGE),
    "nan_width": Fault("the width is NaN", INVENTED, lose_width),
    "hand_garbage_reply": Fault("random bytes on the hand's TCP", INVENTED, lambda _, hand: babble(hand)),
    "slip_out": Fault("what is held slips out; the fingers close", DOCUMENTED, watch=slip),
}


class Faults:
    """One fault at a time, from one order to the next."""

    def __init__(self, arm: ArmService, hand: HandService, journal: Journal) -> None:
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
        """Do what the fault does each millisecond."""
        if self.name != NONE:
            FAULTS[self.name].watch(self.arm, self.hand)

    def describe(self) -> dict[str, object]:
        """Return the fault that lasts, and when the last one began: the robot's time and CLOCK_MONOTONIC."""
        return {"name": self.name, **self._last}

    def _end(self) -> None:
        if self.name == NONE:
            return
        fault, self.name = FAULTS[self.name], NONE
        self.arm.mend()
        self.hand.mend()
        fault.end(self.arm, self.hand)
        self.journal.write("fault", name=NONE, milliseconds=self.arm.milliseconds)
