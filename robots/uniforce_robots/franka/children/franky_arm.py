"""Serve an arm to the parent: ``franky_arm.py address ignore|enforce torque_Nm force_N``.

franky's tracker runs the torque loop at 1 kHz in a C++ thread of this process. Targets and gains
are passed on.
"""

import os
import sys
import time
from typing import Any

import common
import numpy as np


class Loop:
    """The child's life: idle, in control while there is a tracker, idle again."""

    def __init__(self, client: Any, robot: Any) -> None:
        self.client = client
        self.robot = robot
        self.tracker: Any = None
        self.gains: dict = {}
        self.reported_s = self.ordered_s = 0.0
        # Targets are dropped until recovery: those on their way must not move the arm after it.
        self.lost_control = False

    def run(self) -> None:
        """Serve until the parent closes the pipe or the robot dies."""
        while (todo := common.orders(common.REPORT_s)) is not None:
            for order in todo:
                self.ordered_s = time.monotonic()
                self.obey(order)
            self.rest_when_alone()
            if time.monotonic() - self.reported_s >= common.REPORT_s:
                self.report()
        self.stop()

    def obey(self, order: dict) -> None:
        """Take one order."""
        match order["do"]:
            case "target":
                self.pull_to(np.array(order["pose"]).reshape(4, 4).T)
            case "gains":
                self.gains = order
                if self.tracker is not None:
                    self.tracker.set_gains(gains=self.native_gains())
            case "stop":
                self.stop(order["at_once"])
                common.say("stopped")
            case "recover":
                self.recover()

    def pull_to(self, pose: np.ndarray) -> None:
        """Send a target (4, 4); the first one takes control."""
        if self.lost_control:
            return
        try:
            if self.tracker is None:
                self.take_control()
            elif not self.robot.is_in_control:
                self.robot.join_motion(0.0)  # raises what ended it
                raise RuntimeError("control ended without a reason")
            self.tracker.set_target(self.client.Affine(pose))
        except self.client.NetworkException:
            raise
        except common.client_errors(self.client) as error:
            self.lost_control = True
            self.tracker = None
            common.say_lost(self.report(), str(error))

    def take_control(self) -> None:
        """Start the tracker; it pulls at nothing before its first target."""
        self.tracker = self.client.CartesianImpedanceTracker(
            self.robot,
            gains=self.native_gains(),
            translational_error_clip=np.array(self.gains["clip_m"]),
            rotational_error_clip=np.full(3, self.gains["clip_rad"]),
        )

    def native_gains(self) -> Any:
        """Return the gains as the client's own; damping unset is critical, 2√K."""
        gains = self.client.CartesianImpedanceGains()
        gains.stiffness = np.array(self.gains["stiffness"])
        return gains

    def rest_when_alone(self) -> None:
        """Pull towards the measured pose, once, when the parent has fallen silent."""
        if self.tracker is not None and time.monotonic() - self.ordered_s > common.SILENCE_s:
            self.ordered_s = float("inf")
            self.tracker.set_target(self.robot.state.O_T_EE)

    def stop(self, at_once: bool = False) -> None:
        """Let go. The tracker brakes by the readings, until they say that the arm rests."""
        tracker, self.tracker = self.tracker, None
        if tracker is None:
            return
        try:
            (self.robot if at_once else tracker).stop()
        except common.client_errors(self.client):
            return  # it had lost control before; the state says why

    def recover(self) -> None:
        """Clear a reflex; nothing moves."""
        self.stop()
        try:
            self.robot.recover_from_errors()  # its answer may be of a state from before
        except self.client.CommandException as error:
            common.say_lost(self.report(), str(error))
            return
        _ = self.robot.state  # a queued one may be from before
        self.lost_control = not common.say_recovered(self.report())

    def report(self) -> Any:
        """Pass the newest state on; about 0.3 ms, up to 1 s when the robot has died."""
        self.reported_s = time.monotonic()
        state = self.robot.state
        common.report(state, columns(state.O_T_EE))
        return state


def columns(pose: Any) -> list[float]:
    """Return the 16 numbers of a pose, column by column."""
    numbers: list[float] = np.array(pose.matrix).T.ravel().tolist()
    return numbers


def run(client: Any) -> None:
    """Say ``connected``, then states until the parent closes the pipe."""
    address, realtime, torque_Nm, force_N = sys.argv[1:5]
    mode = client.RealtimeConfig.Ignore if realtime == "ignore" else client.RealtimeConfig.Enforce
    # 0.05: motions of franky's own, of which we use none, would be slow
    robot = common.connect(
        client, "Robot", address, relative_dynamics_factor=0.05, realtime_config=mode
    )
    robot.set_collision_behavior(float(torque_Nm), float(force_N))
    _ = robot.state  # a queued one may be from before
    state = robot.state
    common.say("connected", flange_to_ee=columns(state.F_T_EE), load_kg=float(state.m_load))
    Loop(client, robot).run()


if __name__ == "__main__":
    common.serve("franky", run)
    os._exit(0)  # the client's destructor waits for states that may never come
