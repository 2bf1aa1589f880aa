"""Arm, hand and the orders on standard input in one single-threaded loop."""

import argparse
import json
import os
import select
import socket
import time
from collections.abc import Callable

import numpy as np

from uniforce_robots.standins.control import InputLines, say
from uniforce_robots.standins.fci.arm import TICK_s, Wall
from uniforce_robots.standins.fci.arm_service import ArmService
from uniforce_robots.standins.fci.hand import HandService
from uniforce_robots.standins.fci.link import Journal
from uniforce_robots.standins.fci.protocol import ErrorBit, ProtocolError

ANSWER = "order"  # the word before an order's answer
CATCH_UP_s = 0.05  # a loop that lags more forgets the lag instead of racing through it
DIED = 9  # exit code of the death a test asked for


class Server:
    """The stand-in; it obeys ``orders`` by name. ``options`` are those of ``__main__``."""

    arm_service: type[ArmService] = ArmService
    hand_service: type[HandService] = HandService

    def __init__(self, options: argparse.Namespace) -> None:
        self.journal = Journal(options.log)
        self.arm = self.arm_service(options.address, options.server_version, self.journal)
        self.hand = self.hand_service(options.address, self.journal)
        self.mute = options.mute
        self._input = InputLines()
        self.orders: dict[str, Callable[..., object]] = {
            "look": lambda: None,
            "reflex": lambda: self.arm.reflex(frozenset({ErrorBit.CARTESIAN_REFLEX})),
            "user_stop": self.arm.user_stop,
            "die": die,
            "release": self.arm.release,
            "guide": self.arm.guide,
            "mute": lambda on=True: setattr(self, "mute", bool(on)),
            "miss_rule": lambda on=True: setattr(self.arm, "miss_rule", bool(on)),
            "wrench": self._set_wrench,
            "wall": self._set_wall,
            "object": lambda width_m: setattr(self.hand.hand, "object_m", float(width_m)),
        }

    def run(self) -> None:
        """Serve until the input ends."""
        due = time.monotonic()
        while not self._input.ended:
            now = time.monotonic()
            if now >= due and self.arm.is_due(now):
                if not self.mute:
                    self.tick()
                due = max(due + TICK_s, now - CATCH_UP_s)
                now = time.monotonic()
            self._serve(max(due - now, 0.0) if now < due else TICK_s / 5)

    def tick(self) -> None:
        """Let one millisecond of the robot's time pass."""
        self.arm.tick()
        self.hand.tick(time.monotonic())

    def _serve(self, timeout_s: float) -> None:
        """Answer what has arrived, or wait for it; ``select`` waits finer than ``epoll``."""
        sources: list[socket.socket | int] = [*self._input.files]
        if not self.mute:
            sources += [*self.arm.link.sockets(), *self.hand.link.sockets()]
        for ready in select.select(sources, [], [], timeout_s)[0]:
            self._route(ready)

    def _route(self, ready: socket.socket | int) -> None:
        if isinstance(ready, int):
            for line in self._input.read():
                say(f"{ANSWER} {json.dumps(self._obey(line))}")
        elif ready is self.arm.link.udp:
            for datagram in self.arm.link.datagrams():
                self.arm.receive_command(datagram)
        elif ready is self.hand.link.udp:
            list(self.hand.link.datagrams())  # the hand takes none
        else:
            self._read_device(self.arm if ready in self.arm.link.sockets() else self.hand, ready)

    def _read_device(self, service: ArmService | HandService, ready: socket.socket) -> None:
        link = service.link
        if ready is link.listener:
            if link.accept():
                service.client_gone()
        elif ready is link.client:
            for message in link.receive():
                try:
                    service.answer(message)
                except ProtocolError as error:  # a payload that can't be read ends the connection
                    link.drop(str(error))
            if link.client is None:
                service.client_gone()

    def _obey(self, line: str) -> dict[str, object]:
        try:
            order = json.loads(line)
            what = order.pop("do")
            if what not in self.orders:
                raise ValueError(f"do: expected one of {sorted(self.orders)}, got {what!r}")
            self.orders[what](**order)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            return {"error": f"{type(error).__name__}: {error}"}
        return self.describe()

    def describe(self) -> dict[str, object]:
        """Return what an order is answered with."""
        return {"arm": self.arm.describe(), "hand": self.hand.describe()}

    def _set_wrench(self, newtons: list[float]) -> None:
        wrench = np.asarray(newtons, float)
        if wrench.shape != (6,):
            raise ValueError(f"wrench: expected 6 numbers, got {wrench.shape}")
        self.arm.arm.wrench_N = wrench
        self.arm.arm.refresh()

    def _set_wall(self, height_m: float | None, stiffness_N_m: float = 5000.0) -> None:
        wall = None
        if height_m is not None:
            wall = Wall(float(height_m), float(stiffness_N_m))
        self.arm.arm.wall = wall
        self.arm.arm.refresh()


def die() -> None:
    """End the process without a word to its clients."""
    os._exit(DIED)
