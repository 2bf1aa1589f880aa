"""Serve an arm to the parent with pylibfranka: ``pylibfranka_arm.py address ignore|enforce torque_Nm force_N``.

Without a target it reads states; with one it runs a Cartesian impedance controller at 1 kHz,
τ = Jᵀ(K e − D ẋ) + c + (I − Jᵀ J⁺ᵀ) τ₀, with the error e clipped, the torque's change limited to what the robot takes,
and the target replaced by the measured pose when the parent falls silent.
"""

import sys
import time
from typing import Any

import common
import numpy as np

TICK_s = 1e-3
TORQUE_STEP_Nm = 0.9  # per millisecond; the robot refuses more than 1
GAINS_TAU_s = 0.1  # time constant of a change of stiffness
POSTURE_Nm_rad, POSTURE_Nms_rad = 10.0, 6.0  # keeps the elbow where it was when control began
BRAKE_Nms_rad = np.array([25.0, 25.0, 25.0, 25.0, 8.0, 8.0, 8.0])  # large joints stop in about 0.1 s
BRAKE_LIMIT_TICKS = 2000
REST_rad_s, REST_Nm = 0.02, 1.0  # slower and with less torque than this the arm is at rest


class Impedance:
    """The control law, without any client: states in, torques out."""

    def __init__(self, q_rad: np.ndarray, pose: np.ndarray) -> None:
        self.target = pose  # (4, 4)
        self.posture_rad = q_rad
        self.clip: np.ndarray = np.zeros(6)
        self.tau_Nm: np.ndarray = np.zeros(7)
        self.K: np.ndarray = np.zeros((6, 6))  # starts soft and moves to the gains
        self.D: np.ndarray = np.zeros((6, 6))
        self._goal_K, self._goal_D = self.K, self.D

    def set_gains(self, stiffness: np.ndarray, clip_m: list[float], clip_rad: float) -> None:
        """Move to a stiffness (6, 6), base frame, with critical damping, 2 √K."""
        values, vectors = np.linalg.eigh(stiffness)
        self._goal_K = stiffness
        self._goal_D = 2 * vectors @ np.diag(np.sqrt(np.clip(values, 0, None))) @ vectors.T
        self.clip = np.array([*clip_m, *[clip_rad] * 3])

    def torques(self, state: Any, J: np.ndarray, coriolis: np.ndarray) -> np.ndarray:
        """(7,) Nm for the next millisecond, with the Jacobian (6, 7) and the Coriolis torques (7,) at a state."""
        q, dq, pose = np.array(state.q), np.array(state.dq), matrix(state.O_T_EE)
        share = TICK_s / GAINS_TAU_s
        self.K = self.K + share * (self._goal_K - self.K)
        self.D = self.D + share * (self._goal_D - self.D)
        turn = self.target[:3, :3] @ pose[:3, :3].T  # to first order a rotation vector
        turn_rad = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        error = np.concatenate([self.target[:3, 3] - pose[:3, 3], turn_rad])
        force = self.K @ np.clip(error, -self.clip, self.clip) - self.D @ (J @ dq)
        posture = POSTURE_Nm_rad * (self.posture_rad - q) - POSTURE_Nms_rad * dq
        nullspace = posture - J.T @ np.linalg.lstsq(J.T, posture, rcond=None)[0]
        return self.limited(J.T @ force + nullspace + coriolis)

    def limited(self, tau_Nm: np.ndarray) -> np.ndarray:
        """Return torques no further from the last ones than the robot takes in a millisecond."""
        self.tau_Nm = self.tau_Nm + np.clip(tau_Nm - self.tau_Nm, -TORQUE_STEP_Nm, TORQUE_STEP_Nm)
        return self.tau_Nm


class Loop:
    """The child's life: idle, in control, idle again."""

    def __init__(self, client: Any, robot: Any) -> None:
        self.client, self.robot = client, robot
        self.model = robot.load_model()
        self.ended = False
        self.gains: dict = {}
        self.target: np.ndarray | None = None
        self.reported_s = 0.0
        # Until recovery targets are dropped: those still on their way must not move the arm after it.
        self.lost_control = False

    def run(self) -> None:
        """Serve until the parent closes the pipe or the robot dies."""
        while not self.ended:
            if self.target is None:
                self.report_in_time(self.robot.read_once())
                self.obey_idle()
            else:
                self.hold_control()

    def obey_idle(self) -> None:
        """Take orders without control."""
        for order in self.take():
            if order["do"] == "recover":
                self.recover()
            elif order["do"] == "stop":
                common.say("stopped")
            else:
                self.remember(order)

    def recover(self) -> None:
        """Clear a reflex; nothing moves."""
        text = ""
        try:
            self.robot.automatic_error_recovery()
        except self.client.CommandException as error:
            text = str(error)
        state = self.state_of_now()
        if text:
            common.say_lost(state, text)
        else:
            self.lost_control = not common.say_recovered(state)

    def state_of_now(self) -> Any:
        """Pass a state on and return it; a queued one may be from before."""
        self.robot.read_once()
        state = self.robot.read_once()
        self.report(state)
        return state

    def take(self) -> list[dict]:
        """Return the orders so far; a closed pipe ends the child."""
        todo = common.orders()
        if todo is None:
            self.ended = True
        return todo or []

    def remember(self, order: dict) -> None:
        """Keep a target or gains."""
        if order["do"] == "target" and not self.lost_control:
            self.target = matrix(order["pose"])
        elif order["do"] == "gains":
            self.gains = order

    def hold_control(self) -> None:
        """Hold control until the order to stop; say why when it is lost."""
        control = None
        try:
            control = self.robot.start_torque_control()
            if self.control(control):
                common.say("stopped")
        except self.client.NetworkException:
            raise
        except common.client_errors(self.client) as error:
            text = str(error)
            control = error.__traceback__ = None  # either would keep the client's lock
            self.lost_control = True
            common.say_lost(self.state_of_now(), text)
        self.target = None

    def control(self, control: Any) -> bool:
        """Run the controller; return whether the parent asked for the end."""
        state, _ = control.readOnce()
        law = Impedance(np.array(state.q), matrix(state.O_T_EE))
        ordered_s, stop, at_once = time.monotonic(), False, False
        while not (stop or self.ended):
            for order in self.take():
                ordered_s = time.monotonic()
                stop = stop or order["do"] == "stop"
                at_once = at_once or bool(order.get("at_once"))
                self.remember(order)
            if at_once or not is_whole(state):
                self.give_up(control, law, state)
                return stop
            self.update(law, state, time.monotonic() - ordered_s)
            control.writeOnce(self.client.Torques(self.torques(law, state).tolist()))
            state, _ = control.readOnce()
            self.report_in_time(state)
        self.brake(control, law, state)
        return stop

    def give_up(self, control: Any, law: Impedance, state: Any) -> None:
        """End the motion on states that can't be believed: no torque follows from them, so the last one is repeated."""
        self.lost_control = True
        command = self.client.Torques(law.tau_Nm.tolist())
        command.motion_finished = True
        control.writeOnce(command)
        self.report(state)
        if not is_whole(state):
            common.say("error", fault="bad_state", text="arm state: expected finite numbers, got NaN or infinity.")

    def update(self, law: Impedance, state: Any, silence_s: float) -> None:
        """Give the law the newest target and gains."""
        if self.gains:
            law.set_gains(np.array(self.gains["stiffness"]), self.gains["clip_m"], self.gains["clip_rad"])
            self.gains = {}
        if self.target is not None and silence_s < common.SILENCE_s:
            law.target = self.target
        elif self.target is not None:
            law.target, self.target = matrix(state.O_T_EE), matrix(state.O_T_EE)

    def torques(self, law: Impedance, state: Any) -> np.ndarray:
        """Evaluate the law at a state."""
        J = np.array(self.model.zero_jacobian(state)).reshape(7, 6).T
        return law.torques(state, J, np.array(self.model.coriolis(state)))

    def brake(self, control: Any, law: Impedance, state: Any) -> None:
        """Damp the joints to rest, let the torques fade, and end the motion in order."""
        for left in reversed(range(BRAKE_LIMIT_TICKS)):
            damping = -BRAKE_Nms_rad * np.array(state.dq)
            command = self.client.Torques(law.limited(damping).tolist())
            rests = np.abs(state.dq).max() < REST_rad_s and np.abs(law.tau_Nm).max() < REST_Nm
            command.motion_finished = bool(rests or not left)
            control.writeOnce(command)
            if command.motion_finished:
                return
            state, _ = control.readOnce()
            self.report_in_time(state)

    def report_in_time(self, state: Any) -> None:
        """Pass a state on if the parent has waited long enough for one."""
        if time.monotonic() - self.reported_s >= common.REPORT_s:
            self.report(state)

    def report(self, state: Any) -> None:
        """Pass a state on."""
        self.reported_s = time.monotonic()
        common.report(state, list(state.O_T_EE))


def is_whole(state: Any) -> bool:
    """Return whether all that the law uses are finite numbers."""
    return bool(np.isfinite([*state.q, *state.dq, *state.O_T_EE]).all())


def matrix(column_major: list[float]) -> np.ndarray:
    """(4, 4) from 16 numbers, column by column."""
    return np.array(column_major).reshape(4, 4).T


def run(client: Any) -> None:
    """Say ``connected``, then states until the parent closes the pipe."""
    address, realtime, torque, force = sys.argv[1:5]
    mode = client.RealtimeConfig.kIgnore if realtime == "ignore" else client.RealtimeConfig.kEnforce
    robot = common.connect(client, "Robot", address, mode)
    torque_Nm, force_N = [float(torque)] * 7, [float(force)] * 6
    robot.set_collision_behavior(torque_Nm, torque_Nm, force_N, force_N)
    loop = Loop(client, robot)
    common.say("connected")
    loop.run()


if __name__ == "__main__":
    common.serve("pylibfranka", run)
