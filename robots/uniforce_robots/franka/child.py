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

from uniforce_vtla.errors import RobotError, expected

log = logging.getLogger(__name__)
LOAD_s = 60.0  # importing a client on a busy machine; not part of the robot's deadline
END_s = 3.0
SCRIPTS = Path(__file__).parent / "children"


class Child:
    """Run one of ``children/``. ``listen`` gets each line as a dict from the reader thread; others wait for a word.

    Args:
        script: file name in ``children/``.
        arguments: its command line.
        listen: called for lines nobody waits for (states); must be quick.
    """

    def __init__(self, script: str, *arguments: str, listen: Callable[[dict], None] | None = None) -> None:
        self._listen = listen or (lambda line: None)
        self._answers: queue.Queue[dict] = queue.Queue()
        command = [sys.executable, str(SCRIPTS / script), *arguments]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        # A daemon, so that a program that forgets close() can end; it never is inside a C++ client.
        self._reader = threading.Thread(target=self._read, name=f"child {script}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            said = json.loads(line)
            if said["say"] == "state":
                self._listen(said)
            else:
                self._answers.put(said)
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
            raise RobotError(
                "client process: expected it to run, got a closed pipe. Connect again.", "ended"
            ) from error

    def wait(self, word: str, deadline_s: float, what: str) -> dict:
        """Return the next line that says ``word``; kill the process if it does not come in time.

        Raises:
            RobotError: an error came instead, the process ended, or the deadline passed.
        """
        end = time.monotonic() + deadline_s
        while True:
            try:
                said = self._answers.get(timeout=max(end - time.monotonic(), 0.001))
            except queue.Empty:
                self.kill()
                do = "Is it switched on, unlocked, FCI activated, and is nobody else connected?"
                came = f"none after {deadline_s:.1f} s"
                raise RobotError(expected(what, "an answer", came, do), "connection") from None
            if said["say"] == word:
                return said
            if said["say"] == "error":
                raise RobotError(f"{what}: {said['text']}", said["fault"])
            if said["say"] == "gone":
                raise RobotError(
                    expected(what, "an answer", "the client process ended", "See its output."), "ended"
                )

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

    def kill(self) -> None:
        """End the process at once: a client that waits for a mute server ignores signals it could catch."""
        self._process.kill()
        self.close()

    def close(self) -> None:
        """Ask the process to end, wait, and kill it if it won't. Safe to call twice."""
        if self._process.stdin and not self._process.stdin.closed:
            try:
                self._process.stdin.close()  # the end of its orders is its order to end
            except BrokenPipeError:
                log.debug("the child had gone before")
        try:
            self._process.wait(END_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        if self._process.stdout:
            self._process.stdout.close()
