"""Serve a hand to the parent: ``hand.py franky|pylibfranka address``. One command at a time.

franky's commands are futures, and states go on while the fingers move. pylibfranka's hold this process until they end.
"""

import os
import sys
import time
from typing import Any

from common import connect, orders, say, serve

END_s = 2.0  # for the answer to a command that was stopped


def exchange(client: Any, gripper: Any) -> None:
    """Report states and outcomes until the parent closes the pipe; then stop the fingers."""
    future = None
    while (todo := orders()) is not None:
        for order in todo:
            future = begin(client, gripper, order)
        if future is not None and (outcome := ended(client, future)) is not None:
            future = None
            say("outcome", ok=outcome)
        report(gripper)
    if future is not None:
        gripper.stop()
        future.wait(END_s)


def begin(client: Any, gripper: Any, order: dict) -> Any:
    """Begin a command; return franky's future of its success, or success itself."""
    name, keys = order["do"], ("width_m", "speed_m_s", "force_N", "inner_m", "outer_m")  # a move has two of them
    try:
        command = getattr(gripper, f"{name}_async", getattr(gripper, name))
        return command(*(order[key] for key in keys if key in order))
    except client.CommandException:
        return False


def ended(client: Any, future: Any) -> bool | None:
    """Return whether a command has succeeded, None while it runs; one that is refused or aborted has not."""
    if isinstance(future, bool):
        return future
    if not future.wait(0):
        return None
    try:
        return bool(future.get())
    except client.CommandException:
        return False


def report(gripper: Any) -> None:
    """Wait for the hand's next state, a tenth of a second, and pass it on."""
    s = gripper.state if hasattr(type(gripper), "state") else gripper.read_once()
    reading = {"width_m": s.width, "max_width_m": s.max_width, "is_grasped": bool(s.is_grasped)}
    say("state", state={"time_s": time.monotonic(), **reading})


def run(client: Any) -> None:
    """Say ``connected``, then states and outcomes until the parent closes the pipe."""
    gripper = connect(client, "Gripper", sys.argv[2])
    say("connected")
    exchange(client, gripper)


if __name__ == "__main__":
    serve(sys.argv[1], run)
    os._exit(0)  # a client's destructor may wait for an answer that never comes
