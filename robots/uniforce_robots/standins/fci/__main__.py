"""``python -m uniforce_robots.standins.fci 127.0.0.2 [--mute] [--server-version 9] …``."""

import argparse
import contextlib
import ipaddress
from pathlib import Path

from uniforce_robots.standins.control import say
from uniforce_robots.standins.fci.server import Server, ServerOptions


def parse(arguments: list[str] | None = None) -> ServerOptions:
    """Return the options of a command line; exits with a message when they make no sense."""
    plain = ServerOptions
    parser = argparse.ArgumentParser(prog="python -m uniforce_robots.standins.fci", description=__doc__)
    parser.add_argument("address", help="loopback address to serve on; the ports are fixed in the clients")
    parser.add_argument("--mute", action="store_true", help="accept connections and never answer")
    parser.add_argument("--server-version", type=int, default=plain.server_version, help="what it claims to be")
    parser.add_argument("--hand-hz", type=float, default=plain.hand_hz, help="states of the hand per second")
    parser.add_argument("--log", type=Path, help="write every message to this file as JSON lines")
    parser.add_argument("--anywhere", action="store_true", help="allow an address that others can reach")
    chosen = vars(parser.parse_args(arguments))
    address = chosen["address"]
    if not chosen.pop("anywhere") and not ipaddress.ip_address(address).is_loopback:
        parser.error(f"{address} is not a loopback address; the stand-in has no password (--anywhere)")
    return ServerOptions(**chosen)


def main(kind: type[Server] = Server) -> None:
    """Serve until ordered to stop."""
    options = parse()
    server = kind(options)
    say(f"ready {options.address}")
    with contextlib.closing(server), contextlib.suppress(KeyboardInterrupt):
        server.run()


if __name__ == "__main__":
    main()
