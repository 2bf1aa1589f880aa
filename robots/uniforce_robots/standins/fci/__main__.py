"""``python -m uniforce_robots.standins.fci 127.0.0.2 [--mute] [--server-version 9] …``."""

import argparse
import contextlib
import ipaddress
from pathlib import Path

from uniforce_robots.standins.control import say
from uniforce_robots.standins.fci.protocol import ARM_VERSION
from uniforce_robots.standins.fci.server import Server


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the options of a command line; exits with a message when they make no sense."""
    parser = argparse.ArgumentParser(
        prog="python -m uniforce_robots.standins.fci", description=__doc__
    )
    parser.add_argument(
        "address", help="loopback address to serve on; the ports are fixed in the clients"
    )
    parser.add_argument("--mute", action="store_true", help="accept connections and never answer")
    parser.add_argument(
        "--server-version", type=int, default=ARM_VERSION, help="what it claims to be"
    )
    parser.add_argument("--log", type=Path, help="write every message to this file as JSON lines")
    parser.add_argument(
        "--anywhere", action="store_true", help="allow an address that others can reach"
    )
    options = parser.parse_args(arguments)
    if not (options.anywhere or ipaddress.ip_address(options.address).is_loopback):
        wrong = f"{options.address} is not a loopback address"
        parser.error(f"{wrong}; the stand-in has no password (--anywhere)")
    return options


def main(kind: type[Server] = Server) -> None:
    """Serve until the input ends, or Ctrl-C."""
    options = parse()
    server = kind(options)
    say(f"ready {options.address}")
    with contextlib.suppress(KeyboardInterrupt):
        server.run()


if __name__ == "__main__":
    main()
