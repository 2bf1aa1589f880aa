"""The robot against faults of the stand-in: ``hostile_trials.py FAULT,… TIMES FOLDER``.

A program of its own, since a client may hang. Adds a row per trial to the fault's ledger in the
folder, and skips what is there. Nothing here was ever run on hardware.
"""

import contextlib
import faulthandler
import logging
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ledger import Ledger
from benchmarks.recorder.rig import new_address
from benchmarks.trust.attempts import begun
from benchmarks.trust.hostile_arm import HostileStandIn
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.guards import GuardLimits
from uniforce_vtla.errors import RobotError
from uniforce_vtla.hand import LOST_s
from uniforce_vtla.keys import AXES

PERIOD_s = 1 / 30
UNDER_WAY_s = 0.6
NOTICE_s = 15.0
AFTER_s = 0.7  # of the robot's own time, in which the arm is looked at
STUCK_s = 45.0  # no trial takes so long
HOLD_s = LEARN_s = 0.5  # the bars
STILL_m = 0.001  # how far the fingers may go from then on
SWAY_m = 0.015
SWAY_s = 1.0  # up to 0.09 m/s
BOX = GuardLimits(low=(0.2, -0.3, 0.1, -np.pi, 0.0), high=(0.7, 0.3, 0.6, np.pi, 0.08))
HELD_m = 0.03  # the object

CONNECTION = ("connection",)
BROKEN = ("bad_state", "jump", "speed", "connection", "force")
RIGHT_NAMES: dict[str, tuple[str, ...]] = {
    "nan_state": ("bad_state",),
    "inf_state": ("bad_state",),
    "nan_force": ("force",),
    "pose_jump": ("jump",),
    "velocity_beyond_physics": ("speed",),
    "frozen_state": ("frozen",),
    "stopped_clock": CONNECTION,
    "state_flood_old": CONNECTION,
    "silent_arm": CONNECTION,
    "garbage_state": BROKEN,  # random numbers: whichever is impossible first
    "wrong_length_state": (*BROKEN, "limit", "reflex"),  # the longer ones may be read as a state
    "lost_commands": ("communication",),
    "arm_garbage_reply": CONNECTION,
    "arm_dropped": CONNECTION,
    "server_death": ("connection", "hand_connection"),  # of both; whichever is noticed first
    "user_stop": ("user_stop",),
    "reflex": ("reflex",),
    "joint_reflex": ("reflex",),
    "torque_discontinuity": ("discontinuity",),
    "joint_velocity": ("limit",),
    "cartesian_velocity": ("limit",),
    "joint_limit": ("limit",),
    "power_limit": ("limit",),
    "hung_hand": ("hand_deadline",),
    "hand_silent": ("hand_stale", "hand_connection"),
    "hand_dropped": ("hand_connection", "hand_stale"),
    "hand_dropped_midway": ("hand_connection", "hand_deadline"),
    "hand_garbage_state": ("hand_state", "hand_stale", "hand_connection"),
    "nan_width": ("hand_state",),
    "hand_garbage_reply": ("hand_connection", "hand_deadline"),
    "slip_out": ("grasp_lost",),
}
GRASPING = ("slip_out",)
# No state arrives that a client could answer: a real arm ends the motion after 20 lost packets, and
# so does this one.
STARVING = ("stopped_clock", "state_flood_old", "silent_arm", "garbage_state", "wrong_length_state")
# The client reads these only when it expects an answer: the trial stops the arm, then asks for
# recovery.
AT_NEXT_ANSWER = ("arm_garbage_reply",)


@dataclass(frozen=True)
class Trial:
    """Result of one fault."""

    kind: str  # the fault
    named: str  # the fault the caller was given, "" for none
    message: str
    # robot's own clock, from when the fault could be known until the arm was at rest
    hold_s: float
    # robot's own clock, from then until the caller knew; the wall's, where the robot is dead or
    # the caller waits for ``recover``
    learnt_s: float
    sent_after: int = 0  # actions that were taken after the caller had learnt
    fingers_m: float = 0.0  # way of the fingers from ``HOLD_s`` after the caller knew
    # how often it was begun in vain: a busy machine stopped the arm, or for another reason
    starved: int = 0
    late_s: float = 0.0  # by how much a sleeper beside it woke too late, at most
    ended_s: float = field(default_factory=time.time)

    @property
    def is_named(self) -> bool:
        """Whether the caller was given its name."""
        return self.named in RIGHT_NAMES[self.kind]

    @property
    def is_held(self) -> bool:
        """Whether arm and fingers were at rest in time."""
        return self.hold_s <= HOLD_s and self.fingers_m <= STILL_m

    @property
    def is_right(self) -> bool:
        """Whether it was named, held and known in time, and no action was taken afterwards."""
        # there ``recover`` waits
        in_time = self.learnt_s <= LEARN_s or self.kind in AT_NEXT_ANSWER
        return self.is_named and in_time and self.is_held and not self.sent_after


def connect(fci: HostileStandIn, folder: Path) -> UniforceFranka:
    """Return a robot whose arm moves and whose hand is still."""
    settings: dict[str, Any] = {"address": fci.address, "guards": BOX}
    robot = UniforceFranka(UniforceFrankaConfig(id="hostile", calibration_dir=folder, **settings))
    robot.connect()
    return robot


def drive(
    robot: UniforceFranka, start: dict[str, float], begun_s: float, width_m: float, for_s: float
) -> None:
    """Act and observe at 30 Hz for so long; raises what the robot raises."""
    end_s = time.monotonic() + for_s
    while time.monotonic() < end_s:
        to_and_fro_m = SWAY_m * np.sin(2 * np.pi * (time.monotonic() - begun_s) / SWAY_s)
        robot.send_action({**start, AXES[0]: start[AXES[0]] + to_and_fro_m, AXES[4]: width_m})
        robot.get_observation()
        time.sleep(PERIOD_s)


def trial(fault: str, address: str, folder: Path) -> Trial:
    """Begin a fault while the arm moves, go on until the caller learns, then look at the arm."""
    with HostileStandIn(address) as fci:
        robot = connect(fci, folder)
        try:
            begun_s, start = time.monotonic(), robot.get_observation()
            width_m = HELD_m - 0.01 if fault in GRASPING else start[AXES[4]]
            fci.do("object", width_m=HELD_m)
            drive(robot, start, begun_s, width_m, UNDER_WAY_s + 2.0 * (fault in GRASPING))
            if fault in AT_NEXT_ANSWER:
                return _stop_and_recover(robot, fci, fault, start)
            return _break(robot, fci, fault, start, begun_s, width_m)
        finally:
            with contextlib.suppress(RobotError):  # a client that hangs says so within 10 s
                robot.disconnect()


def begun_trial(fault: str, address: str, folder: Path) -> Trial:
    """Return a trial; what a starved machine stopped is tried again, and counted."""
    found, starved, late_s = begun(
        fault, lambda: trial(fault, address, folder), lambda row: row.is_right
    )
    return replace(found, starved=starved, late_s=late_s)


def _break(
    robot: UniforceFranka,
    fci: HostileStandIn,
    fault: str,
    start: dict,
    begun_s: float,
    width_m: float,
) -> Trial:
    ordered_s = time.monotonic()
    _order(fci, fault)
    # the fingers are on their way when the fault strikes
    width_m = width_m if fault in GRASPING else 0.05
    named, message = _told(lambda: drive(robot, start, begun_s, width_m, NOTICE_s))
    learnt_s = time.monotonic()
    sent_after = _sends(robot, start)
    fingers_m = 0.0
    if fault == "server_death":
        hold_s = took_s = max(learnt_s - ordered_s, 0.0)
    else:
        fingers_m = _fingers_m(fci, learnt_s)
        known_s = knowable_s(robot, fci, fault, ordered_s)
        hold_s, rate = _hold_s(fci, known_s)
        took_s = rate * max(learnt_s - known_s, 0.0)
    times_s = round(hold_s, 4), round(took_s, 4)
    return Trial(fault, named, message, *times_s, sent_after, round(fingers_m, 5))


def _fingers_m(fci: HostileStandIn, learnt_s: float) -> float:
    """Return how far the fingers go from ``HOLD_s`` after the caller knew."""
    time.sleep(max(learnt_s + HOLD_s - time.monotonic(), 0.0))
    before_m = fci.do("look")["hand"]["width_m"]
    time.sleep(AFTER_s)
    return abs(float(fci.do("look")["hand"]["width_m"]) - before_m)


def _stop_and_recover(robot: UniforceFranka, fci: HostileStandIn, fault: str, start: dict) -> Trial:
    """Break what is read only with the next answer, stop the arm, and ask for recovery."""
    fci.do("fault", name=fault)
    stopped_s = time.monotonic()
    with contextlib.suppress(RobotError):
        robot.send_action({})  # an action that is none stops the arm
    hold_s, _ = _hold_s(fci, stopped_s)
    begun_s = time.monotonic()
    named, message = _told(robot.recover)
    learnt_s = time.monotonic() - begun_s
    times_s = round(hold_s, 4), round(learnt_s, 4)
    return Trial(fault, named, message, *times_s, _sends(robot, start))


def _told(call: Callable[[], object]) -> tuple[str, str]:
    """Return the name of the fault that a call ends with, and its message."""
    try:
        call()
    except RobotError as error:
        return error.fault, str(error)
    return "", ""


def _order(fci: HostileStandIn, fault: str) -> None:
    if fault == "server_death":
        fci.die()
        return
    if fault in STARVING:
        fci.do("miss_rule", on=True)
    fci.do("fault", name=fault)


def knowable_s(robot: UniforceFranka, fci: HostileStandIn, fault: str, ordered_s: float) -> float:
    """Return when the fault could first be known: at once, or when a reading is too old."""
    hand, struck_s = robot._hand, fci.do("look")["hand"]["struck_s"]
    assert hand is not None
    if fault in ("hung_hand", "hand_garbage_reply"):  # the client waits for the rest of an answer
        return hand._deadline_s
    if fault == "hand_silent" and hand._reading is not None:
        return max(ordered_s, hand._reading.time_s + hand.settings.reading_age_s)
    if fault == "slip_out":
        return float(struck_s) + LOST_s
    return ordered_s if struck_s is None else float(struck_s)


def _sends(robot: UniforceFranka, start: dict[str, float]) -> int:
    """Return how many of five good actions were taken though the robot has a fault."""
    return sum(
        not _told(lambda: robot.send_action({axis: start[axis] for axis in AXES}))[0]
        for _ in range(5)
    )


def _hold_s(fci: HostileStandIn, known_s: float) -> tuple[float, float]:
    """Return how long the arm moved after ``known_s``, infinity while it moves, and its rate."""
    look = fci.look_after(AFTER_s)
    arm = look["arm"]
    fault = look["fault"]
    rate = (arm["milliseconds"] - fault["at_ms"]) / max(
        1e3 * (time.monotonic() - fault["at_s"]), 1.0
    )
    if arm["held_since_ms"] is None:
        return float("inf"), rate
    known_ms = fault["at_ms"] + 1e3 * rate * max(known_s - fault["at_s"], 0.0)
    return float(max((arm["last_moving_ms"] or 0) - known_ms, 0.0) / 1e3), rate


def main() -> None:
    """Run what the folder lacks; ends early after a fault that leaves a client hanging."""
    faults, times, out = sys.argv[1:4]
    logging.disable(logging.WARNING)
    rows = Ledger(Path(out))
    address = new_address()
    with tempfile.TemporaryDirectory() as folder:
        for fault in faults.split(","):
            for _ in range(len(rows.read(fault)), int(times)):
                # into the log; works also where a client keeps the GIL
                faulthandler.dump_traceback_later(STUCK_s)
                row = begun_trial(fault, address, Path(folder))
                faulthandler.cancel_dump_traceback_later()
                rows.add(fault, asdict(row))
                if fault in AT_NEXT_ANSWER:
                    # the client hangs, and takes memory without end: a new process goes on
                    return


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # a client that hangs would keep the process for ever
