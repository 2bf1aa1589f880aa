"""Start the stand-in as its own process, order its faults, and end it by its own handle."""

import json
from pathlib import Path

from uniforce_robots.standins.fci.link import read_journal
from uniforce_robots.standins.fci.server import ANSWER
from uniforce_robots.standins.process import ANSWER_S
from uniforce_robots.standins.process import StandIn as AnyStandIn


class StandIn(AnyStandIn):
    """A running stand-in, a context manager; ``do`` orders a fault and returns the state."""

    module = "fci"

    def __init__(self, address: str, *options: str, log: Path | None = None) -> None:
        self.log = log
        if log is not None:
            options = (*options, "--log", str(log))
        super().__init__(self.module, address, *options)

    def do(self, what: str, **details: object) -> dict:
        """Order something (see ``Server``); return ``{"arm": …, "hand": …}`` as they are then.

        Raises ValueError: it makes no sense.
        """
        answer: dict = json.loads(self._ask(json.dumps({"do": what, **details}), ANSWER))
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def die(self) -> None:
        """Let the process vanish without a word to its clients."""
        assert self.process.stdin is not None
        self.process.stdin.write(b'{"do": "die"}\n')
        self.process.wait(ANSWER_S)

    def wire(self) -> list[dict]:
        """Return the log so far."""
        if self.log is None:
            raise RuntimeError("this stand-in was started without a log")
        return read_journal(self.log)
