"""Notice a TCP connection that its other end has closed: both clients wait on for an answer that never comes."""

from __future__ import annotations

import time

import psutil

from uniforce_vtla.errors import RobotError, expected

HAND_PORT = 1338  # of every Franka Hand; the arm's is 1337
LOOK_s = 0.1  # a look costs up to a millisecond


class PeerWatch:
    """Look at the hand's connection of one process, at most every ``LOOK_s``.

    Args:
        pid: of the process the client is in.
        what: for the message, e.g. ``hand at 172.16.0.2``.
    """

    def __init__(self, pid: int, what: str) -> None:
        self._process, self._what, self._looked_s = psutil.Process(pid), what, 0.0
        self._old = self._closed()  # an earlier client in the same process may not have hung up

    def check(self) -> None:
        """Look, if it is time.

        Raises:
            RobotError: ``hand_connection``, the other end has closed.
        """
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOK_s:
            return
        self._looked_s = now_s
        if self._closed() - self._old:
            do = "Check the cable and the robot's controller, then connect again."
            raise RobotError(expected(self._what, "a connection", "one it has closed", do), "hand_connection")

    def _closed(self) -> set[int]:
        """Return the local ports of the hand's connections that the other end has closed."""
        try:
            found = self._process.net_connections("tcp")
        except psutil.Error:  # the process is gone, which its owner notices, or may not be looked at
            return set()
        to_hand = [c for c in found if c.raddr and c.raddr.port == HAND_PORT]
        return {c.laddr.port for c in to_hand if c.status == psutil.CONN_CLOSE_WAIT}
