"""The arm through pylibfranka (extra ``franka-official``), in a child process: each of its calls holds the GIL.

The child runs our own torque loop (``children/arm_loop.py``); this side sends it targets and keeps its newest state.
"""

from __future__ import annotations

import threading
import time

import numpy as np

from uniforce_robots.franka.arm import (
    ROBOT_STOPS,
    ArmSettings,
    ArmState,
    Gains,
    fault_of_errors,
    refuse_stopped,
)
from uniforce_robots.franka.child import Child
from uniforce_vtla.errors import RobotError, expected

TURN_rad = 0.01  # the hand's turn after which the gains are expressed in the base frame anew
STOP_s = 8.0  # braking takes a few tenths of a second; a robot that has died is noticed after one
STATE_AGE_s = 1.5  # the child notices a dead robot after 1 s and says so


class PylibfrankaArm:
    """``Arm`` on pylibfranka 0.21."""

    def __init__(self, settings: ArmSettings) -> None:
        self.settings = settings
        self._gains = settings.gains
        self._gains_rotation: np.ndarray | None = None
        self._child: Child | None = None
        self._lock = threading.Lock()
        self._state: ArmState | None = None
        self._fault: RobotError | None = None
        self._controls = False

    def connect(self) -> None:
        """See ``Arm``."""
        self._state, self._fault, self._controls = None, None, False
        thresholds = (str(self.settings.reflex_torque_Nm), str(self.settings.reflex_force_N))
        child = Child(
            "arm_loop.py", self.settings.address, self.settings.realtime, *thresholds, listen=self._listen
        )
        try:
            child.connect(self.settings.connect_deadline_s, f"robot at {self.settings.address}")
        except RobotError:
            child.close()
            raise
        self._child = child
        self._wait_for_state()

    def _wait_for_state(self) -> None:
        end = time.monotonic() + self.settings.connect_deadline_s
        while self._state is None and time.monotonic() < end:
            self._check()
            time.sleep(0.002)
        self.state()

    def _listen(self, said: dict) -> None:
        state = ArmState(
            time_s=said["time_s"],
            robot_time_s=said["robot_time_s"],
            q_rad=np.array(said["q"]),
            dq_rad_s=np.array(said["dq"]),
            ee_to_base=np.array(said["pose"]).reshape(4, 4).T,
            wrench_N=np.array(said["wrench"]),
            mode=said["mode"],
            success_rate=said["success_rate"],
            errors=tuple(said["errors"]),
        )
        with self._lock:
            self._state = state

    def state(self) -> ArmState:
        """See ``Arm``. Never blocks; the child tells its state a hundred times a second."""
        self._listen_to_faults()
        if self._fault is not None and self._fault.fault not in ROBOT_STOPS:
            raise self._fault  # a reflex or a stop leaves an arm that can be read
        with self._lock:
            state = self._state
        age = float("inf") if state is None else time.monotonic() - state.time_s
        if state is None or age > STATE_AGE_s:
            wanted = f"one younger than {STATE_AGE_s} s"
            raise RobotError(
                expected("arm state", wanted, f"{age:.1f} s", "Is the robot alive?"), "connection"
            )
        return state

    def set_target(self, ee_to_base: np.ndarray) -> None:
        """See ``Arm``."""
        child = self._check()
        if not self._controls:
            refuse_stopped(self.state())
            self._controls, self._gains_rotation = True, None
        self._turn_gains(child, ee_to_base[:3, :3])
        child.send("target", pose=ee_to_base.T.ravel().tolist())

    def _turn_gains(self, child: Child, rotation: np.ndarray) -> None:
        """Express the gains anew when the hand has turned, or when nobody has told the child yet."""
        known = self._gains_rotation
        if known is not None and np.abs(rotation - known).max() <= TURN_rad:
            return
        self._gains_rotation = rotation.copy()
        clips = {"clip_m": self._gains.clip_m, "clip_rad": self._gains.clip_rad}
        child.send("gains", stiffness=self._gains.matrix_in_base(rotation).tolist(), **clips)

    def set_gains(self, gains: Gains) -> None:
        """See ``Arm``. The child moves to them within about 0.1 s."""
        self._gains, self._gains_rotation = gains, None

    def stop(self, at_once: bool = False) -> None:
        """See ``Arm``."""
        if self._child is None or not self._controls:
            return
        self._controls = False
        if self._fault is not None or not self._child.is_alive:
            return  # it lost control before, which set_target tells
        self._child.send("stop", at_once=at_once)
        try:
            self._child.wait("stopped", STOP_s, "arm at rest")
        except RobotError as error:
            self._fault = error
            raise

    def recover(self) -> None:
        """See ``Arm``."""
        if self._child is None or not self._child.is_alive:
            raise RobotError("arm: expected a running client, got none. Connect again.", "connection")
        self._controls = False
        while self._child.poll() is not None:  # what was said about the old fault
            pass
        self._fault = None
        self._child.send("recover")
        self._child.wait("recovered", STOP_s, "recovery")

    def close(self) -> None:
        """See ``Arm``."""
        child, self._child = self._child, None
        if child is not None:
            child.close()

    def _check(self) -> Child:
        """Return the child; raise what it said went wrong."""
        child = self._listen_to_faults()
        if self._fault is not None:
            raise self._fault
        return child

    def _listen_to_faults(self) -> Child:
        if self._child is None:
            raise RobotError("arm: expected connect() first, got no connection. Connect the robot.", "ended")
        said = self._child.poll()
        if said is not None and self._fault is None and said["say"] in ("error", "gone"):
            text, fault = said.get("text", "the client process ended"), said.get("fault", "connection")
            if fault in ("reflex", "other"):  # the robot's own names say more
                fault = fault_of_errors((*said.get("errors", ()), text)) if "reflex" in text else fault
            self._fault = RobotError(f"robot at {self.settings.address}: {text}", fault)
        return self._child
