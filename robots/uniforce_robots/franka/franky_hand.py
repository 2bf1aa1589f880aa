"""The hand through franky: commands are futures, so that states can be read while the fingers move."""

from __future__ import annotations

import logging
import os
import time
from typing import Any

from uniforce_robots.franka.backends import load_client
from uniforce_robots.franka.hand import HandCommand, HandReading, OUTER_m
from uniforce_robots.franka.peer_watch import PeerWatch
from uniforce_vtla.errors import RobotError

log = logging.getLogger(__name__)


class FrankyHand:
    """``HandDriver`` on franky 2.x. The arm's probe has connected to the hand before, within its deadline."""

    reads_while_busy = True

    def __init__(self, address: str) -> None:
        self._address = address
        self._peers: PeerWatch | None = None
        self._franky: Any = None
        self._gripper: Any = None
        self._future: Any = None

    def connect(self) -> None:
        """See ``HandDriver``."""
        self._franky = load_client("franky")
        try:
            self._gripper = self._franky.Gripper(self._address)
            self._peers = PeerWatch(os.getpid(), f"hand at {self._address}")
        except self._errors() as error:
            raise RobotError(f"hand at {self._address}: {error}", "hand_connection") from error

    def begin(self, command: HandCommand) -> None:
        """See ``HandDriver``."""
        gripper = self._gripper
        if command.force_N > 0:
            widths = (command.inner_m, OUTER_m)
            self._future = gripper.grasp_async(
                command.grasp_width_m, command.speed_m_s, command.force_N, *widths
            )
        else:
            self._future = gripper.move_async(command.width_m, command.speed_m_s)

    def poll(self) -> bool | None:
        """See ``HandDriver``. A command the hand refuses or aborts is one that did not succeed."""
        if self._future is None or not self._future.wait(0):
            return None
        future, self._future = self._future, None
        try:
            return bool(future.get())
        except self._franky.CommandException as error:
            log.warning("hand: %s", error)
            return False
        except self._errors() as error:
            raise RobotError(f"hand at {self._address}: {error}", "hand_connection") from error

    def read(self) -> HandReading | None:
        """See ``HandDriver``."""
        try:
            s = self._gripper.state
        except self._errors() as error:
            raise RobotError(f"hand at {self._address}: {error}", "hand_connection") from error
        return HandReading(time.monotonic(), s.width, s.max_width, bool(s.is_grasped))

    def refuse_closed(self) -> None:
        """See ``HandDriver``."""
        if self._peers is not None:
            self._peers.check()

    def stop(self) -> None:
        """See ``HandDriver``. Waits for the command it ends: a future left behind outlives the interpreter."""
        try:
            self._gripper.stop()
            if self._future is not None:
                self._future.wait(2.0)
        except self._errors() as error:
            raise RobotError(f"hand at {self._address}: {error}", "hand_connection") from error

    def close(self) -> None:
        """See ``HandDriver``."""
        self._future = self._gripper = None

    def _errors(self) -> tuple[type[Exception], ...]:
        return (self._franky.Exception, self._franky.GripperException)
