"""Arm and hand through the vendor's client, franky, each in a child process (``children/``).

The client hangs for ever on a server that does not answer. A child that does not answer is killed.
"""

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import psutil

from uniforce_robots.franka.arm import (
    ROBOT_STOPS,
    ArmSetup,
    ArmState,
    refuse_stopped,
    require_setup,
)
from uniforce_robots.franka.child import Child
from uniforce_robots.franka.config import UniforceFrankaConfig
from uniforce_vtla.errors import RobotError, expected
from uniforce_vtla.hand import HandCommand, HandReading, OUTER_m

CLIENT = "franky"
EXTRA = "franka"
DISTRIBUTION = "lerobot_policy_pi05_uniforce"
TURN_rad = 0.01  # the hand's turn after which the gains are expressed in the base frame anew
STOP_s = 8.0  # braking takes a few tenths of a second, longer beside a busy machine
# without braking; a robot that has died is noticed after one second, and a client may hang
GIVE_UP_s = 2.0
STATE_AGE_s = 1.5  # the child notices a dead robot after 1 s and says so
FIRST_READING_s = 3.0  # of the hand, which gives ten a second
HAND_PORT = 1338  # of every Franka Hand; the arm's is 1337
POLL_s = 0.002
LOOK_s = 0.1  # a look at the hand's connection costs up to a millisecond


def require_installed() -> None:
    """Refuse to go on without the client; raises RobotError: names the extra that brings it."""
    if importlib.util.find_spec(CLIENT) is None:
        do = f'Install it: pip install "{DISTRIBUTION}[{EXTRA}]" (Linux x86_64 only).'
        raise RobotError(expected("Franka client", f"{CLIENT} installed", "none", do), "backend")


class Arm:
    """A seven-jointed arm under Cartesian impedance control, used by one thread.

    Every method may raise RobotError; its ``fault`` says what happened.
    """

    def __init__(self, config: UniforceFrankaConfig) -> None:
        self._config = config
        self._gains_rotation: np.ndarray | None = None  # in which the child knows the gains
        self._state: ArmState | None = None
        self._fault: RobotError | None = None
        self._controls = False
        words = (
            config.address,
            config.realtime,
            str(config.reflex_torque_Nm),
            str(config.reflex_force_N),
        )
        self._child = Child(
            f"robot at {config.address}", "franky_arm.py", *words, listen=self._listen
        )
        self.setup: ArmSetup | None = None  # read when connecting

    def connect(self) -> None:
        """Connect within the configured deadline and set the reflex thresholds. Nothing moves.

        Raises RobotError: no answer, another version, or (``frame``) another tool than assumed.
        """
        require_installed()
        self._state = None
        self._fault = None
        self._controls = False
        said = self._child.connect(self._config.connect_deadline_s)
        try:
            flange_to_ee = np.array(said["flange_to_ee"]).reshape(4, 4).T
            self.setup = ArmSetup(flange_to_ee, said["load_kg"])
            require_setup(self.setup, self._config.load_kg)
            wait_for(
                lambda: self._state is not None or self._read_fault(),
                self._config.connect_deadline_s,
            )
            self.state()
        except RobotError:
            self.close()
            raise

    def _listen(self, **state: Any) -> None:
        for name in ("q_rad", "dq_rad_s", "wrench_N"):
            state[name] = np.array(state[name])
        state["ee_to_base"] = np.array(state["ee_to_base"]).reshape(4, 4).T
        state["errors"] = tuple(state["errors"])
        self._state = ArmState(**state)

    def state(self) -> ArmState:
        """Return the newest reading; there are a hundred a second. Never blocks."""
        fault = self._read_fault()
        state = self._state
        if fault is not None and fault.fault not in ROBOT_STOPS:
            raise fault  # a reflex or a stop leaves an arm that can be read
        age_s = float("inf") if state is None else time.monotonic() - state.time_s
        if state is None or age_s > STATE_AGE_s:
            wanted = f"one younger than {STATE_AGE_s} s"
            do = "Is the robot alive?"
            raise RobotError(expected("arm state", wanted, f"{age_s:.1f} s", do), "connection")
        return state

    def set_target(self, ee_to_base: np.ndarray) -> None:
        """Pull towards a pose from now on. The first call takes control of the arm.

        Repeat it: the child holds the measured pose when it receives nothing for 0.3 s.
        """
        if (fault := self._read_fault()) is not None:
            raise fault
        if not self._controls:
            refuse_stopped(self.state())
            self._controls = True
            self._gains_rotation = None
        self._turn_gains(ee_to_base[:3, :3])
        self._child.send("target", pose=ee_to_base.T.ravel().tolist())

    def _turn_gains(self, rotation: np.ndarray) -> None:
        """Express the gains in the base frame, at first and when the hand has turned."""
        known = self._gains_rotation
        gains = self._config.gains
        if known is not None and np.abs(rotation - known).max() <= TURN_rad:
            return
        self._gains_rotation = rotation.copy()
        stiffness = gains.matrix_in_base(rotation).tolist()
        self._child.send("gains", stiffness=stiffness, clip_m=gains.clip_m, clip_rad=gains.clip_rad)

    def stop(self, at_once: bool = False) -> None:
        """Give up control; the arm comes to rest and holds. Does nothing without control.

        ``at_once`` leaves the braking to the robot: where the readings can't be believed.
        """
        controls, self._controls = self._controls, False
        if not controls or self._fault is not None or not self._child.is_alive:
            return  # where control was lost before, set_target says so
        self._child.send("stop", at_once=at_once)
        try:
            self._child.wait("stopped", GIVE_UP_s if at_once else STOP_s)
        except RobotError as error:
            self._fault = error
            raise

    def recover(self) -> None:
        """Clear a reflex. Nothing moves; the next target takes control again."""
        if not self._child.is_alive:
            raise RobotError(
                "arm: expected a running client, got none. Connect again.", "connection"
            )
        self._controls = False
        self._fault = None
        self._child.forget()  # what was said about the old fault
        self._child.send("recover")
        self._child.wait("recovered", STOP_s)

    def close(self) -> None:
        """Stop and hang up. Safe to call twice."""
        self._child.close()

    def _read_fault(self) -> RobotError | None:
        """Return what the child said went wrong, None while all is well."""
        try:
            self._child.poll()
        except RobotError as error:
            self._fault = self._fault or error
        return self._fault


class HandClient:
    """A gripper's client."""

    def __init__(self, config: UniforceFrankaConfig) -> None:
        self._config = config
        self._what = f"hand at {config.address}"
        self._reading: HandReading | None = None
        self._looked_s = 0.0
        self._child = Child(self._what, "hand.py", config.address, listen=self._listen)

    def connect(self) -> None:
        """Open the connection and wait for a reading."""
        require_installed()
        self._reading = None
        try:
            self._child.connect(self._config.connect_deadline_s)
        except RobotError as error:
            do = "Is a Franka Hand mounted, chosen as end effector in Desk, and initialised?"
            raise RobotError(f"{error} {do}", "hand_connection") from error
        wait_for(lambda: self._reading is not None, FIRST_READING_s)

    def _listen(self, **state: Any) -> None:
        self._reading = HandReading(**state)

    def begin(self, command: HandCommand) -> None:
        """Start a command; none is in flight."""
        if command.force_N > 0:
            widths = {
                "width_m": command.grasp_width_m,
                "inner_m": command.inner_m,
                "outer_m": OUTER_m,
            }
            self._child.send(
                "grasp", speed_m_s=command.speed_m_s, force_N=command.force_N, **widths
            )
        else:
            self._child.send("move", width_m=command.width_m, speed_m_s=command.speed_m_s)

    def stop(self) -> None:
        """Stop the fingers where they are; a command in flight ends without success."""
        self._child.send("stop")

    def poll(self) -> bool | None:
        """Return whether the command in flight succeeded, None while it runs.

        Call it often while one runs: the child stops the fingers when it hears nothing for 0.3 s.
        """
        try:
            self._child.send("go_on")
            line = self._child.poll()
        except RobotError as error:
            fault = "hand_connection" if error.fault == "connection" else error.fault
            raise RobotError(str(error), fault) from error
        return None if line is None else bool(line["ok"])

    def read(self) -> HandReading | None:
        """Return the newest reading, None before the first. Never blocks."""
        if not self._child.is_alive:
            raise RobotError(
                f"{self._what}: the client process ended. Connect again.", "hand_connection"
            )
        return self._reading

    def refuse_closed(self) -> None:
        """Raise when the hand has closed the connection: the client would wait for ever.

        Looks at most every ``LOOK_s``; called by any thread.
        """
        now_s = time.monotonic()
        pid = self._child.pid
        if pid is None or now_s - self._looked_s < LOOK_s:
            return
        self._looked_s = now_s
        if is_hand_closed(pid):
            do = "Check the cable and the robot's controller, then connect again."
            raise RobotError(
                expected(self._what, "a connection", "one it has closed", do), "hand_connection"
            )

    def close(self) -> None:
        """Stop the fingers and hang up. Safe to call twice."""
        self._child.close()


def make_backend(config: UniforceFrankaConfig) -> tuple[Arm, HandClient]:
    """Return arm and hand, not yet connected."""
    return Arm(config), HandClient(config)


def wait_for(condition: Callable[[], object], deadline_s: float) -> None:
    """Wait until something is so, or the deadline has passed."""
    end = time.monotonic() + deadline_s
    while not condition() and time.monotonic() < end:
        time.sleep(POLL_s)


def is_hand_closed(pid: int) -> bool:
    """Return whether the other end has closed a connection of a process to a hand."""
    try:
        found = psutil.Process(pid).net_connections("tcp")
    except psutil.Error:  # the process is gone, which its owner notices, or may not be looked at
        return False
    return any(
        c.raddr and c.raddr.port == HAND_PORT and c.status == psutil.CONN_CLOSE_WAIT for c in found
    )
