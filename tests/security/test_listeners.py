"""Servers listen on loopback unless an option says otherwise."""

import ast
import ipaddress
import socket

import psutil
import pytest
from fci_client import RawClient

from uniforce_robots.standins.fci.__main__ import parse
from uniforce_robots.standins.fci.process import StandIn as FciStandIn
from uniforce_robots.standins.fci.protocol import ARM_HEADER
from uniforce_robots.standins.process import StandIn

EVERYWHERE = ("0.0.0.0", "''", '""', "'::'", "INADDR_ANY")
LISTENING = ("bind", "create_server", "HTTPServer", "ThreadingHTTPServer", "start_server", "serve")


def listeners(source):
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    return [
        ast.unparse(call) for call in calls if ast.unparse(call.func).split(".")[-1] in LISTENING
    ]


def test_no_listener_in_the_source_is_open_to_everybody(source_files):
    found = [call for file in source_files for call in listeners(file.read_text())]
    assert len(found) >= 4  # the stand-ins'
    assert not [call for call in found if any(word in call for word in EVERYWHERE)]
    # the search finds what it looks for
    assert listeners("sock.bind(('', 0))") == ["sock.bind(('', 0))"]


def addresses(pid):
    """Return the addresses a process listens on, TCP, and is bound to, UDP."""
    connections = psutil.Process(pid).net_connections("inet")
    open_ones = [
        c for c in connections if c.status == psutil.CONN_LISTEN or c.type == socket.SOCK_DGRAM
    ]
    return [connection.laddr.ip for connection in open_ones]


@pytest.mark.parametrize("name", ["mjpeg", "standins.xela"])
def test_tactile_stand_ins_listen_on_loopback(name):
    with StandIn(name, "rest_s=0.2", "press_s=0", "rate_hz=5") as stand_in:
        found = addresses(stand_in.process.pid)
    assert found and all(ipaddress.ip_address(address).is_loopback for address in found)


def test_the_arms_stand_in_listens_at_its_address():
    with FciStandIn("127.0.0.77") as stand_in:
        found = addresses(stand_in.process.pid)
    assert len(found) >= 4 and set(found) == {"127.0.0.77"}


def test_the_arms_stand_in_goes_nowhere_else_unasked(capsys):
    for address in ("0.0.0.0", "192.168.0.5"):
        with pytest.raises(SystemExit):
            parse([address])
        assert "not a loopback address" in capsys.readouterr().err
    assert parse(["192.168.0.5", "--anywhere"]).address == "192.168.0.5"


def test_the_raw_client_takes_states_on_the_connections_address_alone():
    with (
        socket.create_server(("127.0.0.78", 0)) as server,
        RawClient("127.0.0.78", server.getsockname()[1], ARM_HEADER) as client,
    ):
        assert ipaddress.ip_address(client.udp.getsockname()[0]).is_loopback
