"""A child process that talks JSON lines: what may hang or hold the GIL lives there, and can be killed."""

from __future__ import annotations

import json
import logging
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from uniforce_robots.franka.arm import fault_of
from uniforce_vtla.errors import RobotError, expected

log = logging.getLogger(__name__)
LOAD_s = 60.0  # importing a client on a busy machine; not part of the robot's deadline
END_s = 3.0
POLL_s = 0.002
SCRIPTS = Path(__file__).parent / "children"


def error_of(line: dict, what: str) -> RobotError:
    """Return the error a child has told, or its end."""
    text = line.get("text", "the client process ended")
    fault = fault_of(line.get("fault", "connection"), text, line.get("errors", ()))
    return RobotError(f"{what}: {text}", fault)


class Child:
    """Run one of ``children/``.

    Args:
        script: file name in ``children/``.
        arguments: its command line.
        listen: called by the reader thread for each state, as a dict; must be quick. Other lines wait to be asked for.
    """

    def __init__(self, script: str, *arguments: str, listen: Callable[[dict], None]) -> None:
        self._listen = listen
        self._answers: queue.Queue[dict] = queue.Queue()
        command = [sys.executable, str(SCRIPTS / script), *arguments]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        # A daemon, so that a program that forgets close() can end; it never is inside a C++ client.
        self._reader = threading.Thread(target=self._read, name=f"child {script}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for text in self._process.stdout or ():
            line = json.loads(text)
            if line["say"] == "state":
                self._listen(line)
            else:
                self._answers.put(line)
        self._answers.put({"say": "gone"})

    @property
    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def send(self, do: str, **details: object) -> None:
        """Send an order.

        Raises:
            RobotError: the process is gone.
        """
        try:
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps({"do": do, **details}) + "\n")
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError) as error:  # ValueError: the pipe is closed here
            text = "client process: expected it to run, got a closed pipe. Connect again."
            raise RobotError(text, "ended") from error

    def wait(self, word: str, deadline_s: float, what: str) -> None:
        """Wait for the line that says ``word``; kill the process if it does not come in time.

        Raises:
            RobotError: an error came instead, the process ended, or the deadline passed.
        """
        end = time.monotonic() + deadline_s
        while True:
            try:
                line = self._answers.get(timeout=max(end - time.monotonic(), 0.001))
            except queue.Empty:
                self.close(grace_s=0.0)
                do = "Is it switched on, unlocked, FCI activated, and no other program connected?"
                came = f"none after {deadline_s:.1f} s"
                raise RobotError(expected(what, "an answer", came, do), "connection") from None
            if line["say"] == word:
                return
            if line["say"] == "error":
                raise error_of(line, what)
            if line["say"] == "gone":
                came = "the client process ended"
                raise RobotError(expected(what, "an answer", came, "See its output."), "ended")

    def poll(self) -> dict | None:
        """Return the next line that is no state, None when there is none."""
        try:
            return self._answers.get_nowait()
        except queue.Empty:
            return None

    def connect(self, deadline_s: float, what: str) -> None:
        """Wait until the client is loaded, then for the connection within the deadline."""
        begun = time.monotonic()
        self.wait("loaded", LOAD_s, "Franka client")
        log.info("client loaded in %.1f s", time.monotonic() - begun)
        self.wait("connected", deadline_s, what)

    def wait_for(self, condition: Callable[[], object], deadline_s: float) -> None:
        """Wait until something is so, or the deadline has passed."""
        end = time.monotonic() + deadline_s
        while not condition() and time.monotonic() < end:
            time.sleep(POLL_s)

    def close(self, grace_s: float = END_s) -> None:
        """Ask the process to end, and kill it if it has not after ``grace_s``. Safe to call twice."""
        if self._process.stdin and not self._process.stdin.closed:
            try:
                self._process.stdin.close()  # the end of its orders is its order to end
            except BrokenPipeError:
                log.debug("the child had gone before")
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        if self._process.stdout:
            self._process.stdout.close()
