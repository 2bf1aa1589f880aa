"""A recording session from outside: its terminal read line by line, its keys pressed."""

from __future__ import annotations

import json
import os
import re
import select
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import psutil

from uniforce_robots.standins.process import StandIn
from uniforce_vtla.errors import UniForceError, expected

OVERWRITE = "\r\x1b[K"  # what the live view begins a line with
LOAD_s = 600.0  # imports on a starved machine
END_s = 60.0
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def environment() -> dict[str, str]:
    """Return the environment of programs beside us: one thread each, our own import path."""
    paths = os.pathsep.join(path for path in sys.path if path)
    return os.environ | ONE_THREAD | {"PYTHONPATH": paths, "HF_HUB_OFFLINE": "1"}


class TrialError(UniForceError):
    """A trial didn't come to its point: nothing can be said about the recorder but that."""


@dataclass(frozen=True)
class Line:
    """Lines that a session printed, and when: seconds of ``time.monotonic``."""

    time_s: float
    text: str


class Session:
    """One run of ``uniforce record`` on a pseudo-terminal, forked by ``program``."""

    def __init__(self, program: Program, argv: list[str]) -> None:
        self._program, self._patience = program, program.patience
        self._master, self._slave = os.openpty()
        self._lines: list[Line] = []
        self._new = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self.pid = program.fork(os.ttyname(self._slave), argv)
        self._reader.start()

    @property
    def lines(self) -> list[Line]:
        with self._new:
            return list(self._lines)

    def said(self, pattern: str) -> list[Line]:
        return [line for line in self.lines if re.search(pattern, line.text)]

    def wait_for(self, pattern: str, timeout_s: float, after: int = 0) -> tuple[int, Line]:
        """Return (its number, the line) of the first line from ``after`` on that holds a pattern.

        Times are multiplied by the plan's patience, here and in ``wait_end``. Raises TrialError: it
        ended before, or said nothing of the kind in time.
        """
        deadline_s = time.monotonic() + timeout_s * self._patience
        while True:
            lines = self.lines
            for number in range(after, len(lines)):
                if re.search(pattern, lines[number].text):
                    return number, lines[number]
            after = max(after, len(lines))
            ended = self._program.exit_code() is not None
            if (ended and len(self.lines) == len(lines)) or time.monotonic() > deadline_s:
                last = [line.text for line in lines[-6:]]
                came = f"{'its end' if ended else 'silence'} after {last}"
                raise TrialError(
                    expected("session", f"a line with {pattern!r}", came, "See the lines.")
                )
            with self._new:
                self._new.wait(0.02)

    def press(self, keys: str) -> None:
        """Type; the character with number 3 is Ctrl-C."""
        os.write(self._master, keys.encode())

    def wait_end(self, timeout_s: float) -> int:
        """Return the exit code, -9 if killed; raises TrialError: it hangs; it is killed then."""
        code = self._program.exit_code(timeout_s * self._patience)
        if code is None:
            self._kill()
            came = [line.text for line in self.lines[-4:]]
            raise TrialError(
                expected("session", f"an end within {timeout_s:g} s", came, "It hung.")
            )
        return code

    def processes(self) -> list[psutil.Process]:
        try:
            loop = psutil.Process(self.pid)
            return [loop, *loop.children(recursive=True)]
        except psutil.NoSuchProcess:
            return []

    def close(self) -> None:
        if self._program.exit_code() is None:
            self._kill()
        os.close(self._slave)
        self._reader.join(2.0)
        os.close(self._master)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _kill(self) -> None:
        for process in self.processes():
            process.kill()
        self._program.exit_code(END_s)

    def _read(self) -> None:
        pending = ""
        while True:
            try:
                chunk = os.read(self._master, 65536)
            except OSError:  # the last holder of the terminal has let go
                return
            *whole, pending = (pending + chunk.decode(errors="replace")).split("\n")
            now_s = time.monotonic()
            lines = [Line(now_s, text.rpartition(OVERWRITE)[2].strip("\r")) for text in whole]
            self._program.write_down(lines)
            with self._new:
                self._lines += lines
                self._new.notify_all()


class Program(StandIn):
    """The warm program that sessions are forked from, one at a time; ``log`` gets what they say.

    Waiting times are multiplied by ``patience``.
    """

    def __init__(self, log: Path, patience: float = 1.0) -> None:
        self.patience = patience
        log.parent.mkdir(parents=True, exist_ok=True)
        self._log = log.open("a")
        self._exit: int | None = 0
        with mock.patch.dict(os.environ, environment()):
            super().__init__("benchmarks.recorder.program")

    def fork(self, tty: str, argv: list[str]) -> int:
        self._exit = None
        return int(self._ask(json.dumps({"tty": tty, "argv": argv}), "pid"))

    def exit_code(self, timeout_s: float = 0.0) -> int | None:
        """Return the session's exit code, None while it runs."""
        answers = self.process.stdout
        assert answers is not None
        if self._exit is None and (self._pending or select.select([answers], [], [], timeout_s)[0]):
            self._exit = int(self._answer("exit", END_s))
        return self._exit

    def write_down(self, lines: list[Line]) -> None:
        self._log.writelines(f"{line.time_s:.3f} {line.text}\n" for line in lines)
        self._log.flush()

    def close(self) -> None:
        self._log.close()
        super().close()

    def _answer(self, word: str, timeout_s: float) -> str:
        return super()._answer(word, LOAD_s if word == "ready" else timeout_s)
