"""The hand through pylibfranka, in a child of its own: a command holds the child's GIL until the fingers arrive."""

from __future__ import annotations

import threading
import time

from uniforce_robots.franka.child import Child
from uniforce_robots.franka.hand import HandCommand, HandReading, OUTER_m
from uniforce_robots.franka.peer_watch import PeerWatch
from uniforce_vtla.errors import RobotError

FIRST_READING_s = 3.0


class PylibfrankaHand:
    """``HandDriver`` on pylibfranka 0.21. Gives no readings while a command runs: the client can't."""

    reads_while_busy = False

    def __init__(self, address: str, connect_deadline_s: float) -> None:
        self._address, self._deadline_s = address, connect_deadline_s
        self._child: Child | None = None
        self._lock = threading.Lock()
        self._reading: HandReading | None = None
        self._peers: PeerWatch | None = None

    def connect(self) -> None:
        """See ``HandDriver``."""
        child = Child("hand_loop.py", self._address, listen=self._listen)
        try:
            child.connect(self._deadline_s, f"hand at {self._address}")
        except RobotError:
            child.close()
            raise
        self._child, self._peers = child, PeerWatch(child.pid, f"hand at {self._address}")
        end = time.monotonic() + FIRST_READING_s
        while self._reading is None and time.monotonic() < end:
            time.sleep(0.005)

    def _listen(self, said: dict) -> None:
        reading = HandReading(said["time_s"], said["width_m"], said["max_width_m"], said["is_grasped"])
        with self._lock:
            self._reading = reading

    def begin(self, command: HandCommand) -> None:
        """See ``HandDriver``."""
        child = self._running()
        if command.force_N > 0:
            widths = {"inner_m": command.inner_m, "outer_m": OUTER_m, "force_N": command.force_N}
            child.send("grasp", width_m=command.grasp_width_m, speed_m_s=command.speed_m_s, **widths)
        else:
            child.send("move", width_m=command.width_m, speed_m_s=command.speed_m_s)

    def poll(self) -> bool | None:
        """See ``HandDriver``."""
        child = self._running()
        said = child.poll()
        if said is None:
            return None
        if said["say"] == "outcome":
            return bool(said["ok"])
        text, fault = said.get("text", "the client process ended"), said.get("fault", "connection")
        fault = "hand_connection" if fault == "connection" else fault
        raise RobotError(f"hand at {self._address}: {text}", fault)

    def read(self) -> HandReading | None:
        """See ``HandDriver``."""
        if not self._running().is_alive:
            raise RobotError(
                f"hand at {self._address}: the client process ended. Connect again.", "hand_connection"
            )
        with self._lock:
            return self._reading

    def refuse_closed(self) -> None:
        """See ``HandDriver``."""
        if self._peers is not None:
            self._peers.check()

    def stop(self) -> None:
        """See ``HandDriver``. The client takes no stop while it moves: its process ends, and the hand with it stops."""
        self.close()

    def close(self) -> None:
        """See ``HandDriver``."""
        child, self._child = self._child, None
        if child is not None:
            child.close()

    def _running(self) -> Child:
        if self._child is None:
            raise RobotError("hand: expected connect() first, got no connection. Connect the robot.", "ended")
        return self._child
