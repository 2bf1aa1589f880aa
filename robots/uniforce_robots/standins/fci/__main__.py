"""``python -m uniforce_robots.standins.fci 127.0.0.2 [--mute] [--server-version 9] [--fault NAME] …``."""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import sys
from pathlib import Path

from uniforce_robots.standins.fci.arm_service import ArmOptions
from uniforce_robots.standins.fci.hand import STATE_HZ
from uniforce_robots.standins.fci.hostile import FAULTS, NONE
from uniforce_robots.standins.fci.protocol import ARM_VERSION
from uniforce_robots.standins.fci.server import Server, ServerOptions


def parse(arguments: list[str] | None = None) -> ServerOptions:
    """Return the options of a command line; exits with a message when they make no sense."""
    parser = argparse.ArgumentParser(prog="python -m uniforce_robots.standins.fci", description=__doc__)
    parser.add_argument("address", help="loopback address to serve on; the ports are fixed in the clients")
    parser.add_argument("--mute", action="store_true", help="accept connections and never answer")
    parser.add_argument("--server-version", type=int, default=ARM_VERSION, help="what the arm claims to be")
    parser.add_argument("--miss-rule", action="store_true", help="20 missed commands end a motion")
    parser.add_argument("--no-rules", action="store_true", help="follow commands that a real arm refuses")
    parser.add_argument("--fault", default=NONE, choices=[NONE, *FAULTS], help="start with this one")
    parser.add_argument("--patience-s", type=float, default=ArmOptions.patience_s, help="wait for a command")
    parser.add_argument("--hand-hz", type=float, default=STATE_HZ, help="states of the hand per second")
    parser.add_argument("--log", type=Path, help="write every message to this file as JSON lines")
    parser.add_argument("--anywhere", action="store_true", help="allow an address that others can reach")
    chosen = parser.parse_args(arguments)
    if not chosen.anywhere and not ipaddress.ip_address(chosen.address).is_loopback:
        parser.error(f"{chosen.address} is not a loopback address; the stand-in has no password (--anywhere)")
    arm = ArmOptions(chosen.server_version, chosen.patience_s, chosen.miss_rule, not chosen.no_rules)
    return ServerOptions(chosen.address, arm, chosen.hand_hz, chosen.mute, chosen.log, chosen.fault)


if __name__ == "__main__":
    server = Server(parse())
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    with contextlib.closing(server), contextlib.suppress(KeyboardInterrupt):
        server.run()
