"""Serve a hand to the parent with pylibfranka: ``hand_loop.py address``. States while idle, one command at a time."""

from __future__ import annotations

import sys
import time
from typing import Any

from lines import normal_scheduling, orders, say


def main() -> None:
    """Say ``loaded``, ``connected``, then states and outcomes until the parent closes the pipe."""
    import pylibfranka

    say("loaded")
    try:
        gripper = pylibfranka.Gripper(sys.argv[1])
        normal_scheduling()
        say("connected")
        while (todo := orders()) is not None:
            for order in todo:
                say("outcome", ok=obey(pylibfranka, gripper, order))
            tell(gripper)
    except (RuntimeError, pylibfranka.FrankaException) as error:  # most of its exceptions are RuntimeErrors
        fault = "version" if "ncompatible" in str(error) else "connection"
        say("error", fault=fault, text=str(error))


def obey(pylibfranka: Any, gripper: Any, order: dict) -> bool:
    """Carry out a command; False when it did not succeed, was refused or aborted."""
    try:
        if order["do"] == "grasp":
            widths = {"epsilon_inner": order["inner_m"], "epsilon_outer": order["outer_m"]}
            return bool(gripper.grasp(order["width_m"], order["speed_m_s"], order["force_N"], **widths))
        return bool(gripper.move(order["width_m"], order["speed_m_s"]))
    except pylibfranka.CommandException:
        return False


def tell(gripper: Any) -> None:
    """Wait for the hand's next state, a tenth of a second, and pass it on."""
    s = gripper.read_once()
    say(
        "state",
        time_s=time.monotonic(),
        width_m=s.width,
        max_width_m=s.max_width,
        is_grasped=bool(s.is_grasped),
    )


if __name__ == "__main__":
    main()
