"""Starts a stand-in as a process of its own and talks to it."""

import os
import select
import subprocess
import sys
import time
from typing import Self

from uniforce_vtla.errors import SensorError, expected

READY_S = 240.0  # imports and the simulated cycle: 3 s on a free machine, minutes on a starved one
ANSWER_S = 10.0


class StandIn:
    """A running stand-in, e.g. ``StandIn("slcan", "rate_hz=500")``; ends with its ``with`` block.

    It also ends with its owner. A name with a dot is a module's. Its ``address`` is a port's path,
    or a URL. SensorError: it didn't become ready.
    """

    def __init__(self, name: str, *options: str) -> None:
        self.name = name
        self._pending = b""
        module = name if "." in name else f"uniforce_robots.standins.{name}"
        command = [sys.executable, "-m", module, *options]
        # what we can import, it can
        env = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, bufsize=0, env=env)
        self.address = self._answer("ready", READY_S)

    def inject(self, fault: str) -> None:
        """Break it in the named way, or mend it with "none"; returns once it is so."""
        self._ask(f"fault {fault}")

    def stats(self) -> dict[str, int]:
        """Return the stand-in's own counts."""
        counts = {}
        for word in self._ask("stats").split():
            name, value = word.split("=")
            counts[name] = int(value)
        return counts

    def close(self) -> None:
        """End it."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.communicate(timeout=ANSWER_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _ask(self, line: str, word: str = "") -> str:
        """Send a line and return what follows its first word, or another one, in the answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n".encode())
        return self._answer(word or line.split()[0], ANSWER_S)

    def _answer(self, word: str, timeout_s: float) -> str:
        assert self.process.stdout is not None
        deadline_s = time.monotonic() + timeout_s
        chunk = b"?"
        while b"\n" not in self._pending and chunk:
            wait_s = max(deadline_s - time.monotonic(), 0.0)
            is_there = select.select([self.process.stdout], [], [], wait_s)[0]
            chunk = self.process.stdout.read(4096) if is_there else b""
            self._pending += chunk
        line, _, self._pending = self._pending.partition(b"\n")
        if not line.startswith(f"{word} ".encode()):
            self.process.kill()
            do = "Run it by hand to see why."
            raise SensorError(
                expected(f"stand-in {self.name}", f"'{word} …'", repr(line.decode()), do)
            )
        return line.decode().removeprefix(f"{word} ").strip()
