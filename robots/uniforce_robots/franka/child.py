"""A child process that talks JSON lines. It may hang or hold the GIL, and can be killed."""

import atexit
import json
import logging
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from uniforce_robots.franka.arm import advised, fault_of
from uniforce_vtla.errors import RobotError, expected

log = logging.getLogger(__name__)
LOAD_s = 60.0  # importing a client on a busy machine; not part of the robot's deadline
END_s = 3.0
SCRIPTS = Path(__file__).parent / "children"


class Child:
    """A client in its own process: one of ``children/``, from ``connect`` to ``close``.

    Args:
        what: for messages, e.g. ``robot at 172.16.0.2``.
        script: file name in ``children/``.
        arguments: its command line.
        listen: called by the reader thread with each state's fields; must be quick.
    """

    def __init__(
        self, what: str, script: str, *arguments: str, listen: Callable[..., None]
    ) -> None:
        self._what = what
        self._command = [sys.executable, str(SCRIPTS / script), *arguments]
        self._listen = listen
        self._process: subprocess.Popen[str] | None = None
        self._answers: queue.Queue[dict] = queue.Queue()

    def connect(self, deadline_s: float) -> dict:
        """Start the process, wait until the client is loaded, then for the connection.

        Returns the child's line ``connected``.

        Raises RobotError: as ``wait``; the process is gone then.
        """
        begun = time.monotonic()
        self._answers = queue.Queue()
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(self._command, stdin=pipe, stdout=pipe, text=True)
        # A daemon: a program that forgets close() can end.
        self._reader = threading.Thread(
            target=self._read, args=(self._process, self._answers), daemon=True
        )
        self._reader.start()
        # for a program that ends without close(): its exit must not meet the reader mid-line
        atexit.register(self.close)
        try:
            self.wait("loaded", LOAD_s)
            log.info("client loaded in %.1f s", time.monotonic() - begun)
            return self.wait("connected", deadline_s)
        except RobotError:
            self.close()
            raise

    def _read(self, process: subprocess.Popen[str], answers: queue.Queue[dict]) -> None:
        for text in process.stdout or ():
            line = json.loads(text)
            if line["say"] == "state":
                self._listen(**line["state"])
            else:
                answers.put(line)
        answers.put({"say": "gone"})

    @property
    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """Of the process, None while there is none."""
        return self._process.pid if self._process else None

    def send(self, do: str, **details: object) -> None:
        """Send an order; raises RobotError: there is no process, or no longer."""
        pipe = self._running().stdin
        assert pipe is not None
        try:
            pipe.write(json.dumps({"do": do, **details}) + "\n")
            pipe.flush()
        except BrokenPipeError as error:
            text = f"{self._what}: expected a client that runs, got a closed pipe. Connect again."
            raise RobotError(text, "ended") from error

    def wait(self, word: str, deadline_s: float) -> dict:
        """Return the line that says ``word``; kill the process if it does not come in time.

        Raises RobotError: an error came instead, the process ended, or the deadline passed.
        """
        end = time.monotonic() + deadline_s
        while True:
            try:
                line = self._answers.get(timeout=max(end - time.monotonic(), 0.001))
            except queue.Empty:
                self.close(grace_s=0.0)
                do = "Is it switched on, unlocked, FCI activated, and no other program connected?"
                came = f"none after {deadline_s:.1f} s"
                raise RobotError(
                    expected(self._what, "an answer", came, do), "connection"
                ) from None
            if self._raise_errors(line)["say"] == word:
                return line

    def poll(self) -> dict | None:
        """Return the next line that is no state, None when there is none.

        Raises RobotError: it is an error, or the process has ended.
        """
        self._running()
        try:
            return self._raise_errors(self._answers.get_nowait())
        except queue.Empty:
            return None

    def forget(self) -> None:
        """Drop what was said so far."""
        while not self._answers.empty():
            self._answers.get_nowait()

    def _raise_errors(self, line: dict) -> dict:
        """Return a line; raise what it says went wrong."""
        if line["say"] not in ("error", "gone"):
            return line
        text = line.get("text", "the client process ended; see its output. Connect again.")
        fault = fault_of(line.get("fault", "connection"), text, line.get("errors", ()))
        raise RobotError(f"{self._what}: {advised(text)}", fault)

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None:
            raise RobotError(
                expected(self._what, "connect() first", "no connection", "Call connect()."), "ended"
            )
        return self._process

    def close(self, grace_s: float = END_s) -> None:
        """Ask the process to end; kill it after ``grace_s``. Safe to call twice."""
        atexit.unregister(self.close)
        process, self._process = self._process, None
        if process is None or process.stdin is None or process.stdout is None:
            return
        try:
            process.stdin.close()  # the end of its orders is its order to end
        except BrokenPipeError:
            log.debug("the child had gone before")
        try:
            process.wait(grace_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._reader.join()
        process.stdout.close()
