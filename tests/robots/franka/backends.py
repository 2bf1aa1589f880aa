"""The contract of an arm backend, run against the stand-in: ``backends.py franky|pylibfranka case,… address folder``.

A program of its own, not a test file: both clients in one process fail to import, and what is asserted at the end is
that the process leaves with code 0, not 134.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from uniforce_robots.franka.arm import Arm, ArmSettings, Gains
from uniforce_robots.franka.franky_arm import FrankyArm
from uniforce_robots.franka.franky_hand import FrankyHand
from uniforce_robots.franka.hand import HandDriver, HandThread
from uniforce_robots.franka.limits import HARD_LIMITS, Range
from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.franka.pylibfranka_arm import PylibfrankaArm
from uniforce_robots.franka.pylibfranka_hand import PylibfrankaHand
from uniforce_robots.franka.stream import ArmStream, StreamSettings
from uniforce_robots.standins.fci.process import StandIn, wait_until
from uniforce_vtla.errors import RobotError

PATIENCE_s = 60.0  # a busy machine; the robot's own clock is what is asserted on
for _ages in ("stale_s", "state_age_s"):
    HARD_LIMITS["StreamSettings"][_ages] = Range(0, 100)
HARD_LIMITS["HandSettings"]["reading_age_s"] = Range(0, 100)
PATIENT = StreamSettings(stale_s=PATIENCE_s, state_age_s=PATIENCE_s)


def make(backend: str, address: str, deadline_s: float = PATIENCE_s, gains: Gains | None = None) -> Arm:
    settings = ArmSettings(address, connect_deadline_s=deadline_s, **({"gains": gains} if gains else {}))
    return FrankyArm(settings) if backend == "franky" else PylibfrankaArm(settings)


def make_hand(backend: str, address: str) -> HandDriver:
    return FrankyHand(address) if backend == "franky" else PylibfrankaHand(address, PATIENCE_s)


def fault_within(use: Callable[[], object], seconds: float = PATIENCE_s) -> RobotError:
    """Use something until it raises; a fault that never comes is a failure."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            use()
        except RobotError as error:
            return error
        time.sleep(0.01)
    raise AssertionError(f"no fault within {seconds} s")


def reach(arm: Arm, fci: StandIn, goal: np.ndarray, tolerance_m: float = 2e-3) -> None:
    def arrived() -> bool:
        arm.set_target(goal)
        return bool(np.abs(fci.do("look")["arm"]["position_m"] - goal[:3, 3]).max() < tolerance_m)

    wait_until(arrived, PATIENCE_s, "the target")


def moving(arm: Arm, fci: StandIn) -> None:
    """Take control and be on the way somewhere."""
    goal = arm.state().ee_to_base
    goal[2, 3] -= 0.1
    begun = fci.do("look")["arm"]["position_m"][2]

    def under_way() -> bool:
        arm.set_target(goal)  # again and again: a backend may let go of a target nobody repeats
        return bool(fci.do("look")["arm"]["position_m"][2] < begun - 1e-3)

    wait_until(under_way, PATIENCE_s, "a motion")


def assert_still(fci: StandIn) -> None:
    """Assert that the arm rests half a second of its own time after now."""
    begun = fci.do("look")["arm"]["milliseconds"]
    wait_until(lambda: fci.do("look")["arm"]["milliseconds"] >= begun + 500, PATIENCE_s, "half a second")
    assert fci.do("look")["arm"]["speed_rad_s"] < 1e-3, "the arm still moves"


# --- cases -----------------------------------------------------------------------------------------------------------


def life(backend: str, fci: StandIn) -> None:
    """Connect moves nothing; a target is reached; stop rests; control can be taken again; close can be called twice."""
    arm = make(backend, fci.address)
    arm.connect()
    state = arm.state()
    shown = fci.do("look")["arm"]
    np.testing.assert_allclose(state.ee_to_base[:3, 3], shown["position_m"], atol=1e-4)
    np.testing.assert_allclose(state.ee_to_base[:3, :3], shown["rotation"], atol=1e-4)
    np.testing.assert_allclose(state.q_rad, shown["q_rad"], atol=1e-4)
    assert state.mode == "idle" and not shown["moving"]
    goal = ToolPose(
        state.ee_to_base[:3, 3] + np.array([0.005, 0, -0.01]), ToolPose.from_ee(state.ee_to_base).yaw_rad
    )
    reach(arm, fci, goal.ee_to_base())
    assert arm.state().mode == "move"
    arm.stop()
    assert_still(fci)
    assert fci.do("look")["arm"]["mode"] == "IDLE"
    here = arm.state().ee_to_base
    arm.set_target(here)
    wait_until(lambda: fci.do("look")["arm"]["moving"], PATIENCE_s, "control again")
    arm.close()
    arm.close()
    assert_still(fci)
    thresholds = [line for line in fci.wire() if line["what"] == "thresholds"][-1]
    assert thresholds["upper_force_N"] == [40.0] * 6
    limits = torque_steps(fci.wire())
    assert limits <= 1.0 + 1e-3, f"torque changed by {limits} Nm in a millisecond"
    motions = [line["generator"] for line in fci.wire() if line["what"] == "motion"]
    assert set(motions) == {"NONE"}, motions


def torque_steps(wire: list[dict]) -> float:
    """Return the largest change of a torque between two commands of one motion, Nm."""
    largest, last = 0.0, None
    for line in wire:
        if line["what"] == "motion":
            last = np.zeros(7)
        elif line["what"] == "command" and last is not None:
            tau = np.array(line["tau_Nm"])
            largest, last = max(largest, float(np.abs(tau - last).max())), tau
    return largest


def bound(backend: str, fci: StandIn) -> None:
    """However far the target, the press on a wall is stiffness × clip; turned, the closing axis stays the stiff one."""
    arm = make(backend, fci.address, gains=Gains((400.0, 400.0, 400.0), clip_m=(0.01, 0.01, 0.01)))
    arm.connect()
    pose = arm.state().ee_to_base
    fci.do("wall", height_m=float(pose[2, 3]) - 0.002, stiffness_N_m=20000.0)
    pose[2, 3] -= 0.3
    pressed: list[float] = []

    def settles() -> bool:
        arm.set_target(pose)
        look = fci.do("look")["arm"]
        pressed.append(look["felt_N"][2])
        return look["speed_rad_s"] < 2e-3 and pressed[-1] > 2.0

    wait_until(settles, PATIENCE_s, "a steady press")
    assert abs(pressed[-1] - 4.0) < 0.8, f"pressed {pressed[-1]:.2f} N, stiffness × clip is 4 N"
    arm.close()


def reflex(backend: str, fci: StandIn) -> None:
    """A reflex is named, the arm can be read, motion is refused until recovery and possible after it."""
    arm = make(backend, fci.address)
    arm.connect()
    moving(arm, fci)
    fci.do("reflex")
    here = np.eye(4)
    assert fault_within(lambda: arm.set_target(arm.state().ee_to_base)).fault == "reflex"
    assert_still(fci)
    wait_until(lambda: arm.state().mode == "reflex", PATIENCE_s, "the mode")
    arm.stop()
    assert fault_within(lambda: arm.set_target(here), 5.0).fault == "reflex"
    arm.recover()
    assert_still(fci)
    assert not fci.do("look")["arm"]["moving"], "recovery moves nothing"
    goal = arm.state().ee_to_base
    goal[0, 3] += 0.005
    reach(arm, fci, goal)
    arm.close()


def user_stop(backend: str, fci: StandIn) -> None:
    """A pressed stop is named; while it is pressed recovery fails or changes nothing."""
    arm = make(backend, fci.address)
    arm.connect()
    moving(arm, fci)
    fci.do("user_stop")
    assert fault_within(lambda: arm.set_target(arm.state().ee_to_base)).fault == "user_stop"
    assert_still(fci)
    arm.close()


def death(backend: str, fci: StandIn) -> None:
    """A robot that vanishes is an error of the connection, and nothing hangs."""
    arm = make(backend, fci.address)
    arm.connect()
    moving(arm, fci)
    fci.die()
    assert fault_within(lambda: (arm.set_target(np.eye(4)), arm.state())).fault in ("connection", "ended")
    begun = time.monotonic()
    arm.close()
    assert time.monotonic() - begun < 20.0


def stream(backend: str, fci: StandIn) -> None:
    """The whole way down under the stream: actions move the arm, a user stop ends all, every thread is joined."""
    arm = make(backend, fci.address)
    arm.connect()
    stream = ArmStream(arm, PATIENT)
    stream.start()
    goal = ToolPose.from_ee(stream.state.ee_to_base)
    goal = ToolPose(goal.position_m + np.array([0, 0, -0.01]), goal.yaw_rad)
    stream.submit(goal)
    position = goal.position_m
    wait_until(
        lambda: abs(fci.do("look")["arm"]["position_m"][2] - position[2]) < 2e-3, PATIENCE_s, "the goal"
    )
    fci.do("user_stop")
    wait_until(lambda: stream.fault is not None, PATIENCE_s, "the fault")
    assert stream.fault is not None and stream.fault.fault == "user_stop", stream.fault
    assert_still(fci)
    stream.stop()
    arm.close()


def hand(backend: str, fci: StandIn) -> None:
    """Open, grasp an object, fail to grasp nothing: one command at a time on the wire."""
    thread = HandThread(make_hand(backend, fci.address))
    thread.start()
    assert abs(thread.reading.width_m - 0.08) < 1e-6
    fci.do("object", width_m=0.03)
    thread.submit(0.02)
    wait_until(lambda: thread.reading.is_grasped, PATIENCE_s, "a grasp")
    assert abs(fci.do("look")["hand"]["force_N"] - 10.0) < 1e-9
    thread.submit(0.06)
    wait_until(
        lambda: abs(thread.reading.width_m - 0.06) < 1e-3 and not thread.is_busy, PATIENCE_s, "an open hand"
    )
    fci.do("object", width_m=0.0)
    thread.submit(0.02)
    wait_until(lambda: thread.failed_grasps == 1, PATIENCE_s, "a failed grasp")
    thread.stop()
    requests = [line for line in fci.wire() if line["what"] == "request" and line["device"] == "hand"]
    assert [r["command"] for r in requests] == ["CONNECT", "GRASP", "MOVE", "GRASP"], requests
    assert not any(r["busy"] for r in requests)


def robot(backend: str, fci: StandIn) -> None:
    """The LeRobot robot from end to end: act, be stopped by a person, refuse, leave the arm still."""
    from uniforce_robots.franka.config import UniforceFrankaConfig
    from uniforce_robots.franka.guards import GuardLimits
    from uniforce_robots.franka.robot import UniforceFranka

    box = GuardLimits(low=(0.2, -0.3, 0.1, -np.pi, 0.0), high=(0.7, 0.3, 0.6, np.pi, 0.08))
    config = UniforceFrankaConfig(
        id="dry-run",
        calibration_dir=Path(fci.log).parent if fci.log else None,
        address=fci.address,
        backend=backend,  # type: ignore[arg-type]
        connect_deadline_s=PATIENCE_s,
        stream=PATIENT,
        guards=box,
    )
    robot = UniforceFranka(config)
    robot.connect()
    goal = robot.get_observation()
    goal["z.pos"] -= 0.01
    goal["width.pos"] = 0.05

    def arrived() -> bool:
        robot.send_action(goal)
        seen = robot.get_observation()
        return abs(seen["z.pos"] - goal["z.pos"]) < 2e-3 and abs(seen["width.pos"] - 0.05) < 2e-3

    wait_until(arrived, PATIENCE_s, "arm and hand at the goal")
    fci.do("user_stop")
    assert fault_within(lambda: robot.send_action(goal)).fault == "user_stop"
    assert_still(fci)
    fci.do("release")
    robot.recover()
    assert not fci.do("look")["arm"]["moving"], "recovery moves nothing"
    robot.send_action(robot.get_observation())
    wait_until(lambda: fci.do("look")["arm"]["moving"], PATIENCE_s, "control again")
    robot.disconnect()
    assert_still(fci)
    assert not fci.do("look")["arm"]["moving"]


def version(backend: str, fci: StandIn) -> None:
    """Another server version is refused by name, with the server's own words."""
    try:
        make(backend, fci.address).connect()
    except RobotError as error:
        assert error.fault == "version" and "9" in str(error), (error.fault, error)
    else:
        raise AssertionError("connected to another version")


def mute(backend: str, fci: StandIn) -> None:
    """A server that never answers is an error within 3 s of the client being loaded."""
    loaded: list[float] = []

    class Clock(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if "client loaded" in record.getMessage():
                loaded.append(time.monotonic())

    logger = logging.getLogger("uniforce_robots.franka.child")
    logger.setLevel(logging.INFO)
    logger.addHandler(Clock())
    try:
        make(backend, fci.address, deadline_s=2.5).connect()
    except RobotError as error:
        took = time.monotonic() - loaded[0]
        assert error.fault == "connection" and "none after 2.5 s" in str(error), (error.fault, error)
        assert took < 3.0, f"{took:.2f} s"
    else:
        raise AssertionError("connected to a mute server")


OPTIONS = {"version": ("--server-version", "9"), "mute": ("--mute",)}
CASES = {
    case.__name__: case
    for case in (life, bound, reflex, user_stop, death, stream, hand, robot, version, mute)
}


def main() -> None:
    backend, cases, address, folder = sys.argv[1:5]
    for case in cases.split(","):
        sys.stderr.write(f"--- {case}\n")
        with StandIn(address, *OPTIONS.get(case, ()), log=Path(folder) / f"{case}.jsonl") as fci:
            CASES[case](backend, fci)
    sys.stdout.write("passed\n")


if __name__ == "__main__":
    main()
