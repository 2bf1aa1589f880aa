"""JSON lines to and from the parent. A module on its own: our package would load torch."""

import importlib
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

# a state for the parent that often, by the host's clock: also when the loop is late
REPORT_s = 0.01
SILENCE_s = 0.3  # of the parent, after which the target is the measured pose
MODES = ("other", "idle", "move", "guiding", "reflex", "user_stopped", "recovery")
STOPPED = {"reflex": "reflex", "user_stopped": "user_stop", "guiding": "guiding"}
STDIN = 0
_buffer = b""


def say(word: str, **details: object) -> None:
    """Send a line to the parent."""
    sys.stdout.write(json.dumps({"say": word, **details}) + "\n")
    sys.stdout.flush()


def orders(wait_s: float = 0.0) -> list[dict] | None:
    """Return the parent's orders so far, or None once it has closed the pipe, which means: end."""
    global _buffer
    if not select.select([STDIN], [], [], wait_s)[0]:
        return []
    data = os.read(STDIN, 65536)
    if not data:
        return None
    *lines, _buffer = (_buffer + data).split(b"\n")
    return [json.loads(line) for line in lines]


def client_errors(client: Any) -> tuple[type[Exception], ...]:
    """Return all that the client raises: its own errors, and those of its C++ standard library."""
    return client.Exception, client.GripperException, RuntimeError, ValueError


def connect(client: Any, kind: str, *arguments: Any, **options: Any) -> Any:
    """Return the client's ``Robot`` or ``Gripper``.

    Run by root, its constructor takes SCHED_FIFO 99. That is given up: with this priority one busy
    Python thread starves the machine.
    """
    connected = getattr(client, kind)(*arguments, **options)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return connected


def serve(name: str, run: Callable[[Any], None]) -> None:
    """Say ``loaded`` once the client is imported, then run; ``error`` when the connection failed.

    Ctrl-C, a closed terminal and a service's end reach every process of the program. They are
    ignored here: the parent stops the robot, by a stop or by the end of the pipe.
    """
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    client = importlib.import_module(name)
    say("loaded")
    try:
        run(client)
    except client_errors(client) as error:
        fault = "version" if "ncompatible" in str(error) else "connection"
        say("error", fault=fault, text=str(error))


def report(state: Any, pose: list[float]) -> None:
    """Pass an arm's state on; ``pose`` has 16 numbers, column by column."""
    reading = {
        "time_s": time.monotonic(),
        "robot_time_s": state.time.to_sec(),
        "q_rad": list(state.q),
        "dq_rad_s": list(state.dq),
        "ee_to_base": pose,
        "wrench_N": list(state.O_F_ext_hat_K),
        "mode": mode_of(state),
        "success_rate": float(state.control_command_success_rate),
        "errors": error_names(state),
    }
    say("state", state=reading)


def say_lost(state: Any, text: str) -> None:
    """Report to the parent that control is gone, and the mode that says why."""
    say("error", fault=STOPPED.get(mode_of(state), "other"), text=text, errors=error_names(state))


def say_recovered(state: Any) -> bool:
    """Report to the parent whether the arm may move again, and return it."""
    mode = mode_of(state)
    if mode in STOPPED:
        text = f"recovery: expected an arm that may move, got mode {mode}."
        do = "Release the stop or the joints by hand."
        say("error", fault=STOPPED[mode], text=f"{text} {do}", errors=error_names(state))
    else:
        say("recovered")
    return mode not in STOPPED


def mode_of(state: Any) -> str:
    """Return a state's mode in the project's words."""
    return MODES[int(state.robot_mode.value)]


def error_names(state: Any) -> list[str]:
    """Return the robot's own names of what stopped it, those of now or else of the last motion."""
    if mode_of(state) != "reflex":
        return []
    for errors in (state.current_errors, state.last_motion_errors):
        names = [
            name
            for name in dir(errors)
            if not name.startswith("_") and getattr(errors, name) is True
        ]
        if names:
            return names
    return []
