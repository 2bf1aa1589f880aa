"""A SpaceMouse: HID reports on a local packet socket (SOCK_SEQPACKET); see ``--help``."""

import struct
import sys
import tempfile
from dataclasses import dataclass

from uniforce_robots.standins.control import StandInServer
from uniforce_robots.standins.plugs import Sockets
from uniforce_vtla.arguments import parse

BURST = 40  # reports at once: what a reader that sleeps would find queued
REST = (0,) * 6


@dataclass
class SpaceMouseConfig:
    """Show a SpaceMouse: at rest it is silent, with the fault ``push`` its cap is deflected.

    Example: cd tests; python -m standins.spacemouse push=100,0,0,0,0,0
    """

    push: str = "0,-350,0,0,0,0"  # counts of x, y, z and the turns about them while pushed
    rate_hz: float = 60.0  # wireless ones were seen at some 62
    fault: str = "none"  # what it does from the start
    seed: int = 0


def reports(counts, buttons, layout="three"):
    """Return the reports of one state: three axes in each of two, or all ``six`` in one."""
    button = struct.pack("<BH", 3, buttons)
    if layout == "six":
        return [struct.pack("<B6h", 1, *counts), button]
    return [struct.pack("<B3h", 1, *counts[:3]), struct.pack("<B3h", 2, *counts[3:]), button]


class SpaceMouseStandIn(StandInServer):
    """Sends the pushed state at its rate, the state of rest once."""

    faults = ("push", "close", "freeze", "garbage", "short", "burst", "unplug")

    def __init__(self, config):
        self._folder = tempfile.TemporaryDirectory(prefix="uniforce-spacemouse-")
        path = f"{self._folder.name}/device"
        super().__init__(Sockets(path, lambda client: b""), path, config, config.rate_hz)
        push = reports(tuple(int(word) for word in config.push.split(",")), 0)
        closing = reports(REST, 1)
        self._due = {"push": push, "burst": push * BURST, "close": closing, "short": [b"\x01\x00"]}

    def on_fault(self):
        super().on_fault()
        for report in reports(REST, 0) if self.fault == "none" else []:
            self.plug.send(report)

    def beat(self):
        """Send reports; at rest, or frozen, it is silent."""
        garbage = [bytes([self.rng.choice([1, 2])]) + b"\xff\x7f" * 3]
        for report in garbage if self.fault == "garbage" else self._due.get(self.fault, []):
            self.plug.send(report)


if __name__ == "__main__":
    sys.exit(SpaceMouseStandIn(parse(SpaceMouseConfig)).run())
