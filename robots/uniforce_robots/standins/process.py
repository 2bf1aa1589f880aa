"""Starts a stand-in as a process of its own and talks to it."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from types import TracebackType
from typing import IO

from uniforce_vtla.errors import SensorError, expected

READY_S = 240.0  # imports and the simulated cycle: 3 s on a free machine, minutes on a starved one
ANSWER_S = 10.0


class StandIn:
    """A running stand-in, e.g. ``StandIn("slcan", "rate_hz=500")``; ends with its ``with`` block or its owner.

    Attributes:
        address: where it is: a port's path, or a URL.

    Raises:
        SensorError: it didn't become ready.
    """

    def __init__(self, name: str, *options: str) -> None:
        self.name = name
        command = [sys.executable, "-m", f"uniforce_robots.standins.{name}", *options]
        paths = os.pathsep.join(path for path in sys.path if path)  # what we can import, it can
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            env=os.environ | {"PYTHONPATH": paths},
        )
        self._lines: queue.Queue[str] = queue.Queue()
        assert self._process.stdout is not None
        threading.Thread(target=_pump, args=(self._process.stdout, self._lines), daemon=True).start()
        self.address = self._answer("ready", READY_S)

    def inject(self, fault: str) -> None:
        """Break it in the named way, or mend it with "none"; returns once it is so."""
        self._send(f"fault {fault}")
        self._answer("fault", ANSWER_S)

    def stats(self) -> dict[str, int]:
        """Return the stand-in's own counts."""
        self._send("stats")
        words = self._answer("stats", ANSWER_S).split()
        return {name: int(value) for name, value in (word.split("=") for word in words)}

    def stop(self) -> None:
        """End it."""
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait(ANSWER_S)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()

    def __enter__(self) -> StandIn:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _send(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def _answer(self, word: str, timeout_s: float) -> str:
        try:
            line = self._lines.get(timeout=timeout_s)
        except queue.Empty:
            line = ""
        if not line.startswith(f"{word} "):
            self._process.kill()
            do = "Run it by hand to see why."
            raise SensorError(expected(f"stand-in {self.name}", f"'{word} …'", repr(line), do))
        return line.removeprefix(f"{word} ").strip()


def _pump(stream: IO[str], lines: queue.Queue[str]) -> None:
    try:
        for line in stream:
            lines.put(line)
    except ValueError:
        pass  # closed under us: the process was stopped
    lines.put("")
