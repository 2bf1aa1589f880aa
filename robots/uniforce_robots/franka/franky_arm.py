"""The arm through franky (extra ``franka``): its tracker runs the 1 kHz torque loop in a C++ thread of this process."""

from __future__ import annotations

import ctypes
import logging
import os
import time
from typing import Any

import numpy as np

from uniforce_robots.franka.arm import ArmSettings, ArmState, Gains, refuse_stopped
from uniforce_robots.franka.backends import fault_of, load_client
from uniforce_robots.franka.child import Child
from uniforce_vtla.errors import RobotError, expected

log = logging.getLogger(__name__)
MODES = {
    "Other": "other",
    "Idle": "idle",
    "Move": "move",
    "Guiding": "guiding",
    "Reflex": "reflex",
    "UserStopped": "user_stopped",
    "AutomaticErrorRecovery": "recovery",
}
RETRY_s = 0.1
END_s = 1.5  # the client itself gives up a silent robot after 1 s
TURN_rad = 0.01  # the hand's turn after which the gains are expressed in the base frame anew


class FrankyArm:
    """``Arm`` on franky 2.x."""

    def __init__(self, settings: ArmSettings, has_hand: bool = False) -> None:
        self.settings = settings
        self._probe_hand = ["hand"] if has_hand else []
        self._gains = settings.gains
        self._gains_rotation = np.eye(3)
        self._franky: Any = None
        self._robot: Any = None
        self._tracker: Any = None

    def connect(self) -> None:
        """See ``Arm``. A child connects first: where a mute server hangs it, it is killed and this process lives."""
        franky = load_client("franky")
        child = Child("probe.py", self.settings.address, *self._probe_hand)
        try:
            child.connect(self.settings.connect_deadline_s, f"robot at {self.settings.address}")
        finally:
            child.close()
        self._franky = franky
        mode = (
            franky.RealtimeConfig.Ignore
            if self.settings.realtime == "ignore"
            else franky.RealtimeConfig.Enforce
        )
        try:
            self._robot = self._open(mode)
            # By root, the constructor puts this thread on SCHED_FIFO 99: one busy Python thread starves the machine.
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            self._robot.set_collision_behavior(self.settings.reflex_torque_Nm, self.settings.reflex_force_N)
        except client_errors(franky) as error:
            raise self._error(error) from error
        self.state()  # the first one after a setter may be a stale one from the queue

    def _open(self, realtime: Any) -> Any:
        """Connect; for a moment the robot may still see the child that went before, and takes one client only."""
        end = time.monotonic() + self.settings.connect_deadline_s
        while True:
            try:
                # 0.05: motions of franky's own, of which we use none, would be slow
                return self._franky.Robot(
                    self.settings.address, relative_dynamics_factor=0.05, realtime_config=realtime
                )
            except self._franky.NetworkException as error:
                if time.monotonic() > end:
                    raise
                log.info("robot at %s: %s; once more", self.settings.address, error)
                time.sleep(RETRY_s)

    def state(self) -> ArmState:
        """See ``Arm``; about 0.3 ms, up to 1 s when the robot has died."""
        robot = self._connected()
        try:
            s = robot.state
        except client_errors(self._franky) as error:
            raise self._error(error) from error
        return ArmState(
            time_s=time.monotonic(),
            robot_time_s=s.time.to_sec(),
            q_rad=np.array(s.q),
            dq_rad_s=np.array(s.dq),
            ee_to_base=np.array(s.O_T_EE.matrix),
            wrench_N=np.array(s.O_F_ext_hat_K),
            mode=MODES[s.robot_mode.name],
            success_rate=float(s.control_command_success_rate),
            errors=error_names(s) if s.robot_mode.name == "Reflex" else (),
        )

    def set_target(self, ee_to_base: np.ndarray) -> None:
        """See ``Arm``."""
        robot = self._connected()
        try:
            if self._tracker is None:
                self._take_control(ee_to_base[:3, :3])
            elif not robot.is_in_control:
                raise self._lost()
            self._turn_gains(ee_to_base[:3, :3])
            self._tracker.set_target(self._franky.Affine(ee_to_base))
        except client_errors(self._franky) as error:
            raise self._error(error) from error

    def set_gains(self, gains: Gains) -> None:
        """See ``Arm``. The tracker's clips are fixed while it runs: with other ones it is started anew."""
        clips_differ = (gains.clip_m, gains.clip_rad) != (self._gains.clip_m, self._gains.clip_rad)
        self._gains = gains
        if self._tracker is None:
            return
        if clips_differ:
            self.stop()
        else:
            self._tracker.set_gains(gains=self._native(self._gains_rotation))

    def stop(self, at_once: bool = False) -> None:
        """See ``Arm``. The tracker brakes by the readings, and waits until they say that the arm rests."""
        tracker, self._tracker = self._tracker, None
        if tracker is None:
            return
        try:
            (self._robot if at_once else tracker).stop()
        except client_errors(self._franky) as error:  # it had lost control before, which set_target tells
            log.info("tracker stopped after: %s", error)

    def recover(self) -> None:
        """See ``Arm``."""
        self.stop()
        robot = self._connected()
        try:
            recovered = robot.recover_from_errors()
        except client_errors(self._franky) as error:
            raise self._error(error) from error
        if not recovered:
            do = "Release the user stop or the joints by hand."
            raise RobotError(expected("recovery", "an arm without errors", "errors", do), "reflex")

    def close(self) -> None:
        """See ``Arm``."""
        if self._robot is None:
            return
        self.stop()
        robot, self._robot = self._robot, None
        if not self._has_ended(robot):
            # Its destructor would wait for the client's own thread with Python's lock held, for ever: it never runs,
            # not even when the program ends.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(robot))
            log.error("the Franka client hangs: end this process before you connect again")

    def _has_ended(self, robot: Any) -> bool:
        """Return whether the client's thread is out of its last motion; it waits for states that may never come."""
        try:
            return bool(robot.join_motion(END_s))
        except client_errors(self._franky):  # how the motion ended, which is known
            return True

    def _connected(self) -> Any:
        if self._robot is None:
            raise RobotError("arm: expected connect() first, got no connection. Connect the robot.", "ended")
        return self._robot

    def _take_control(self, rotation: np.ndarray) -> None:
        refuse_stopped(self.state())
        self._gains_rotation = rotation.copy()
        self._tracker = self._franky.CartesianImpedanceTracker(
            self._robot,
            gains=self._native(rotation),
            translational_error_clip=np.array(self._gains.clip_m),
            rotational_error_clip=np.full(3, self._gains.clip_rad),
        )

    def _turn_gains(self, rotation: np.ndarray) -> None:
        """Express the gains anew when the hand has turned."""
        if np.abs(rotation - self._gains_rotation).max() > TURN_rad:
            self._gains_rotation = rotation.copy()
            self._tracker.set_gains(gains=self._native(rotation))

    def _native(self, rotation: np.ndarray) -> Any:
        gains = self._franky.CartesianImpedanceGains()  # damping unset: critical, 2√K
        gains.stiffness = self._gains.matrix_in_base(rotation)
        return gains

    def _lost(self) -> RobotError:
        """Say why the tracker runs no longer."""
        try:
            self._robot.join_motion(0.0)
        except client_errors(self._franky) as error:
            return self._error(error)
        return RobotError("arm: expected control, got none and no reason. Connect again.", "other")

    def _error(self, error: Exception) -> RobotError:
        text = str(error)
        if isinstance(error, self._franky.NetworkException):
            return RobotError(f"robot at {self.settings.address}: {text}", "connection")
        if isinstance(error, self._franky.IncompatibleVersionException):
            return RobotError(f"robot at {self.settings.address}: {text}", "version")
        return RobotError(f"robot at {self.settings.address}: {text}", fault_of(text))


def error_names(state: Any) -> tuple[str, ...]:
    """Return the names of the errors in a client's state, those of now or else of the last motion."""
    for errors in (state.current_errors, state.last_motion_errors):
        names = tuple(
            name for name in dir(errors) if not name.startswith("_") and getattr(errors, name) is True
        )
        if names:
            return names
    return ()


def client_errors(franky: Any) -> tuple[type[Exception], ...]:
    """Return all that franky raises: its own, and what becomes of the standard library's errors in its C++."""
    return (franky.Exception, ValueError, RuntimeError)
