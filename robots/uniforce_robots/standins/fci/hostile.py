"""Every fault the stand-in can be ordered to have, by name.

Nothing here was ever run on hardware. Each entry says where the fault comes from:

* ``DOCUMENTED``: Franka's manuals, headers or published client name it as something the robot does.
* ``REPORTED``: users of real robots have written of it in public.
* ``INVENTED``: no source; what a broken cable, memory or clock might do, and a client has to survive it.

A fault is begun by ``{"do": "fault", "name": NAME}`` on the control socket and taken back by the name ``none``. What
has happened stays so: a dropped connection, a reflex, an object that slipped out. One fault at a time.

Faults of the states corrupt what is told, never the arm: ``describe()`` tells where it really is. Where the client
can't answer (``starves``), the stand-in doesn't wait for it and drives the arm by the last torque at 1 kHz. A real arm
stops after 20 lost packets; the order ``miss_rule`` makes this one do so too.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass

from uniforce_robots.standins.fci import hostile_states as states
from uniforce_robots.standins.fci.arm_service import ArmService
from uniforce_robots.standins.fci.hand_service import HandService
from uniforce_robots.standins.fci.link import Link
from uniforce_robots.standins.fci.protocol import HAND_STATE_BYTES, STATE_BYTES, ErrorBit

NONE = "none"
DIED = 9  # exit code of the death a test asked for
DOCUMENTED, REPORTED, INVENTED = "documented", "reported", "invented"
GARBAGE_BYTES = (1, 200)  # of what stands for an answer

Act = Callable[[ArmService, HandService], None]


def nothing(arm: ArmService, hand: HandService) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class Fault:
    """One way to be broken.

    Attributes:
        does: one line.
        source: DOCUMENTED, REPORTED or INVENTED.
        begin: what happens at once.
        watch: what happens each millisecond while the fault lasts.
        end: what has to be taken back beside the wire.
    """

    does: str
    source: str
    begin: Act = nothing
    watch: Act = nothing
    end: Act = nothing


def says(wire: states.ArmWire) -> Act:
    """Return what makes the arm's states go through ``wire``."""
    return lambda arm, _: setattr(arm, "outgoing", wire)


def hand_says(wire: states.HandWire) -> Act:
    """Return what makes the hand's states go through ``wire``."""
    return lambda _, hand: setattr(hand, "outgoing", wire)


def starves(wire: states.ArmWire) -> Act:
    """Return what leaves a client without a state it can answer."""

    def begin(arm: ArmService, hand: HandService) -> None:
        arm.outgoing, arm.starved = wire, True

    return begin


def freeze(arm: ArmService, hand: HandService) -> None:
    """Tell the same pose from now on."""
    arm.outgoing = states.frozen(arm.newest())


def stop_clock(arm: ArmService, hand: HandService) -> None:
    """Send the newest state again and again."""
    starves(states.repeated(arm.newest()))(arm, hand)


def send_old(arm: ArmService, hand: HandService) -> None:
    """Send what was sent before again."""
    starves(states.old([*arm.sent, arm.newest()], random.Random(0)))(arm, hand)


def babble(link: Link) -> None:
    """Say random bytes at once, and in place of every answer."""
    source = random.Random(0)
    link.garbage = lambda: source.randbytes(source.randint(*GARBAGE_BYTES))
    link.send_bytes(link.garbage())


def babble_arm(arm: ArmService, hand: HandService) -> None:
    """Answer the arm's client with random bytes."""
    babble(arm.link)


def babble_hand(arm: ArmService, hand: HandService) -> None:
    """Answer the hand's client with random bytes."""
    babble(hand.link)


def drop_arm(arm: ArmService, hand: HandService) -> None:
    """Close the arm's connection."""
    arm.link.drop("fault")
    arm.client_gone()


def drop_hand(arm: ArmService, hand: HandService) -> None:
    """Close the hand's connection."""
    hand.link.drop("fault")
    hand.client_gone()


def drop_hand_midway(arm: ArmService, hand: HandService) -> None:
    """Close the hand's connection once a command is under way."""
    if hand.is_midway:
        hand.struck_s = time.monotonic()
        drop_hand(arm, hand)


def hang_hand(arm: ArmService, hand: HandService) -> None:
    """Stop the fingers once a command is under way."""
    if hand.is_midway and not hand.hung:
        hand.hung, hand.struck_s = True, time.monotonic()


def slip(arm: ArmService, hand: HandService) -> None:
    """Lose what is held."""
    if hand.hand.is_grasped:
        hand.struck_s = time.monotonic()
        hand.hand.slip()


def deafen(arm: ArmService, hand: HandService) -> None:
    """Lose every command, under the rule that 20 in a row end a motion."""
    arm.hears = False


def reflex(bit: ErrorBit) -> Act:
    """Return what stops the arm by reflex for this reason."""
    return lambda arm, _: arm.reflex(frozenset({bit}))


def die(arm: ArmService, hand: HandService) -> None:
    """End the process without a word to its clients."""
    arm.journal.flush()
    os._exit(DIED)


def press_stop(arm: ArmService, hand: HandService) -> None:
    """Press the stop button."""
    arm.user_stop()


def release_stop(arm: ArmService, hand: HandService) -> None:
    """Let go of the stop button."""
    arm.release()


_random = random.Random(0)
_garbage = states.garbage(STATE_BYTES, _random)
_hand_garbage = states.garbage(HAND_STATE_BYTES, _random)
_nan, _inf = float("nan"), float("inf")

FAULTS = {
    # the arm's states
    "nan_state": Fault("pose, joints, speeds are NaN", INVENTED, says(states.all_are(states.MEASURED, _nan))),
    "inf_state": Fault("pose, joints, speeds are inf", INVENTED, says(states.all_are(states.MEASURED, _inf))),
    "nan_force": Fault("force estimates are NaN", INVENTED, says(states.all_are(states.FORCES, _nan))),
    "pose_jump": Fault("joint 1 jumps by 0.3 rad, the pose with it", INVENTED, says(states.turned)),
    "velocity_beyond_physics": Fault("joints at 10 × their fastest", INVENTED, says(states.too_fast)),
    "frozen_state": Fault("time goes on, pose and joints stay", INVENTED, freeze),
    "stopped_clock": Fault("the same state again and again", INVENTED, stop_clock),
    "state_flood_old": Fault("old states only, in any order, 5 a ms", INVENTED, send_old),
    "silent_arm": Fault("no states; TCP stays open", REPORTED, starves(states.silent)),
    "garbage_state": Fault("random bytes of a state's length", INVENTED, starves(_garbage)),
    "wrong_length_state": Fault("0 to 4000 random bytes", INVENTED, starves(states.wrong_length(_random))),
    # the arm's connection
    "lost_commands": Fault("no command arrives; 20 in a row end a motion", DOCUMENTED, deafen),
    "arm_garbage_reply": Fault("random bytes on the arm's TCP", INVENTED, babble_arm),
    "arm_dropped": Fault("the arm closes its TCP connection", REPORTED, drop_arm),
    "server_death": Fault("the process ends; every socket closes", INVENTED, die),
    # what stops a real arm
    "user_stop": Fault("the stop button is pressed", DOCUMENTED, press_stop, end=release_stop),
    "reflex": Fault("a collision at the hand", DOCUMENTED, reflex(ErrorBit.CARTESIAN_REFLEX)),
    "joint_reflex": Fault("a collision at a joint", DOCUMENTED, reflex(ErrorBit.JOINT_REFLEX)),
    "torque_discontinuity": Fault(
        "a torque step above 1 Nm/ms", DOCUMENTED, reflex(ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY)
    ),
    "joint_velocity": Fault("a joint too fast", DOCUMENTED, reflex(ErrorBit.JOINT_VELOCITY_VIOLATION)),
    "cartesian_velocity": Fault("a hand too fast", DOCUMENTED, reflex(ErrorBit.CARTESIAN_VELOCITY_VIOLATION)),
    "joint_limit": Fault("a joint's end", DOCUMENTED, reflex(ErrorBit.JOINT_POSITION_LIMITS_VIOLATION)),
    "power_limit": Fault("too much power", DOCUMENTED, reflex(ErrorBit.POWER_LIMIT_VIOLATION)),
    # the hand
    "hung_hand": Fault("fingers stop midway, no answer any more; states go on", REPORTED, watch=hang_hand),
    "hand_silent": Fault("no states; TCP stays open", INVENTED, hand_says(states.silent)),
    "hand_dropped": Fault("the hand closes its TCP connection", INVENTED, drop_hand),
    "hand_dropped_midway": Fault("the same, within a command", INVENTED, watch=drop_hand_midway),
    "hand_garbage_state": Fault("random bytes of a state's length", INVENTED, hand_says(_hand_garbage)),
    "nan_width": Fault("the width is NaN", INVENTED, hand_says(states.no_width)),
    "hand_garbage_reply": Fault("random bytes on the hand's TCP", INVENTED, babble_hand),
    "slip_out": Fault("what is held slips out; the fingers close", DOCUMENTED, watch=slip),
}
