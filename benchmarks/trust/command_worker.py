"""A process that holds one command and runs it on one command line after another; a killed one is replaced."""

import importlib
import multiprocessing
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

START_S = 600.0  # imports of all commands, once, on a busy machine


def import_once(modules: Sequence[str]) -> None:
    """Let all workers be forked from a process that has imported ``modules``."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(list(modules))


@dataclass(frozen=True)
class Ended:
    """How a run ended: the exit code, None where it was still at work; and what it printed."""

    code: int | None
    said: str


class CommandWorker:
    """Runs ``module:function`` in a process group of its own, in ``folder``."""

    def __init__(self, entry: str, folder: Path) -> None:
        self.entry, self.folder = entry, folder
        self._process: Any = None

    def run(self, words: Sequence[str], limit_s: float) -> Ended:
        """Return how the command ended; one at work after ``limit_s`` is killed with all it started."""
        if self._process is None:
            self._start()
        self._connection.send(list(words))
        if not self._connection.poll(limit_s):
            self.close()
            return Ended(None, "")
        try:
            return Ended(*self._connection.recv())
        except EOFError:  # it ended its own process
            self.close()
            return Ended(None, "the process ended")

    def close(self) -> None:
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.join()
            self._process = None

    def _start(self) -> None:
        context = multiprocessing.get_context("forkserver")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(self.entry, str(self.folder), other))
        self._process.start()
        other.close()
        if not self._connection.poll(START_S):
            raise TimeoutError(f"{self.entry} did not start within {START_S:g} s")
        self._connection.recv()


def _serve(entry: str, folder: str, connection: Connection) -> None:
    os.setsid()
    os.chdir(folder)
    sys.argv = [entry]
    os.environ["HF_HUB_OFFLINE"] = "1"
    module, function = entry.split(":")
    main = getattr(importlib.import_module(module), function)
    connection.send("ready")
    while True:
        words = connection.recv()
        with tempfile.TemporaryFile() as output:
            with _redirected(output):
                code = _code(main, words)
            output.seek(0)
            connection.send((code, output.read().decode(errors="replace")))


@contextmanager
def _redirected(output: IO[bytes]) -> Any:
    kept = os.dup(1), os.dup(2)
    try:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, copy in enumerate(kept, start=1):
            os.dup2(copy, number)
            os.close(copy)


def _code(main: Any, words: Sequence[str]) -> int:
    try:
        return int(main(words) or 0)
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 1
