"""Start the stand-in as its own process, order its faults, and end it by its own handle."""

import json
import socket
from pathlib import Path

from uniforce_robots.standins.fci.link import read_journal
from uniforce_robots.standins.fci.server import CONTROL_PORT
from uniforce_robots.standins.process import StandIn as AnyStandIn

ANSWER_s = 10.0


class StandIn(AnyStandIn):
    """A running stand-in. Use as a context manager; ``do`` orders a fault and returns what the arm and hand show."""

    module = "fci"

    def __init__(self, address: str, *options: str, log: Path | None = None) -> None:
        self.log = log
        super().__init__(self.module, address, *options, *(("--log", str(log)) if log else ()))
        self._control = socket.create_connection((address, CONTROL_PORT), ANSWER_s)
        self._answers = self._control.makefile("r")

    def do(self, what: str, **details: object) -> dict:
        """Order something (see ``Server``) and return ``{"arm": …, "hand": …}`` as they are afterwards."""
        self._control.sendall(json.dumps({"do": what, **details}).encode() + b"\n")
        answer = json.loads(self._answers.readline())
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def die(self) -> None:
        """Let the process vanish without a word to its clients."""
        self._control.sendall(b'{"do": "die"}\n')
        self.process.wait(ANSWER_s)

    def wire(self) -> list[dict]:
        """Return the log so far."""
        if self.log is None:
            raise RuntimeError("this stand-in was started without a log")
        if self.process.poll() is None:
            self.do("flush")
        return read_journal(self.log)

    def close(self) -> None:
        """End the process, and hang up."""
        super().close()
        self._answers.close()
        self._control.close()
