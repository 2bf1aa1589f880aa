import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from uniforce_robots.franka.peer_watch import HAND_PORT, LOOK_s, PeerWatch
from uniforce_vtla.errors import RobotError


@pytest.fixture
def connection(address: str) -> Iterator[tuple[socket.socket, socket.socket]]:
    """A hand's server side and client side, both in this process."""
    with ExitStack() as closing:
        server = closing.enter_context(socket.create_server((address, HAND_PORT)))
        client = closing.enter_context(socket.create_connection((address, HAND_PORT)))
        accepted, _ = server.accept()
        yield closing.enter_context(accepted), client


def test_a_hand_that_hangs_up_is_noticed(connection: tuple[socket.socket, socket.socket]) -> None:
    watch = PeerWatch(os.getpid(), "hand")
    watch.check()
    connection[0].close()
    time.sleep(LOOK_s)
    with pytest.raises(RobotError, match="one it has closed") as caught:
        watch.check()
    assert caught.value.fault == "hand_connection"


def test_a_connection_that_was_closed_before_says_nothing(
    connection: tuple[socket.socket, socket.socket],
) -> None:
    connection[0].close()
    time.sleep(LOOK_s)
    PeerWatch(os.getpid(), "hand").check()


def test_it_looks_no_more_often_than_it_needs_to(connection: tuple[socket.socket, socket.socket]) -> None:
    watch = PeerWatch(os.getpid(), "hand")
    watch.check()
    connection[0].close()
    watch.check()
