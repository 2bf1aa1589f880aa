"""Serve a hand to the parent: ``hand.py address``. One command at a time, until it ends or stops.

States come from a thread of their own: each takes a tenth of a second, and a stop can't wait.
"""

import os
import sys
import threading
import time
from typing import Any

import common

POLL_s = 0.005
END_s = 2.0  # for the answer to a command that was stopped


class Loop:
    """The child's life: idle while ``future`` is None, else a command is under way."""

    def __init__(self, client: Any, gripper: Any) -> None:
        self.client = client
        self.gripper = gripper
        self.future: Any = None
        self.is_stopping = False
        self.ordered_s = 0.0

    def run(self) -> None:
        """Serve until the parent closes the pipe; then stop the fingers."""
        threading.Thread(target=self.report, daemon=True).start()
        while (todo := common.orders(POLL_s)) is not None:
            for order in todo:
                self.ordered_s = time.monotonic()
                self.obey(order)
            if self.future is not None and (self.is_stopping or self.is_alone()):
                # again and again: one that came before the command was on its way is lost
                self.stop()
            self.say_outcome()
        end_s = time.monotonic() + END_s
        while self.future is not None and time.monotonic() < end_s:
            self.stop()
            if self.future.wait(POLL_s):
                return

    def obey(self, order: dict) -> None:
        """Take one order: a grasp, a move, a stop, or a sign that the parent is there."""
        if order["do"] in ("grasp", "move"):
            self.is_stopping = False
        match order["do"]:
            case "grasp":
                widths = order["inner_m"], order["outer_m"]
                speed_and_force = order["speed_m_s"], order["force_N"]
                self.future = self.gripper.grasp_async(order["width_m"], *speed_and_force, *widths)
            case "move":
                self.future = self.gripper.move_async(order["width_m"], order["speed_m_s"])
            case "stop":
                self.stop()

    def stop(self) -> None:
        """Stop the fingers where they are."""
        self.is_stopping = True
        try:
            self.gripper.stop()
        except self.client.CommandException as error:
            common.say("error", fault="connection", text=f"the hand does not stop: {error}")

    def is_alone(self) -> bool:
        """Return whether the parent has fallen silent."""
        return time.monotonic() - self.ordered_s > common.SILENCE_s

    def say_outcome(self) -> None:
        """Report how the command ended; one that is refused or stopped has not succeeded."""
        if self.future is None or not self.future.wait(0):
            return
        future, self.future, self.is_stopping = self.future, None, False
        try:
            succeeded = bool(future.get())
        except self.client.CommandException:
            succeeded = False
        common.say("outcome", ok=succeeded)

    def report(self) -> None:
        """Pass on each state of the hand, about ten a second; end the child when they cease."""
        try:
            while True:
                s = self.gripper.state
                reading = {
                    "width_m": s.width,
                    "max_width_m": s.max_width,
                    "is_grasped": bool(s.is_grasped),
                }
                common.say("state", state={"time_s": time.monotonic(), **reading})
        except common.client_errors(self.client) as error:
            common.say("error", fault="connection", text=str(error))
            os._exit(1)  # the main thread may wait in the client for ever


def run(client: Any) -> None:
    """Say ``connected``, then states and outcomes until the parent closes the pipe."""
    gripper = common.connect(client, "Gripper", sys.argv[1])
    common.say("connected")
    Loop(client, gripper).run()


if __name__ == "__main__":
    common.serve("franky", run)
    os._exit(0)  # the client's destructor may wait for an answer that never comes
