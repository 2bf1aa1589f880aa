"""JSON lines between a child and its parent. A plain module for its neighbours: the package loads torch."""

from __future__ import annotations

import json
import os
import select
import sys

_buffer = b""
STDIN = 0


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


def normal_scheduling() -> None:
    """Give up the real-time priority the clients take for the calling thread when run by root.

    At SCHED_FIFO 99 one busy Python thread starves the machine.
    """
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
