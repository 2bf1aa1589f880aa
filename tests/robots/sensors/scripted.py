"""Devices that obey a test: in place of ``cv2.VideoCapture``, and a source of any samples."""

import socket
import threading
import time
from contextlib import contextmanager
from itertools import cycle

import numpy as np

from uniforce_robots.sensors.faults import LostSensorError
from uniforce_robots.sensors.reader import SampleSource, Stamped, now_ns


class ScriptedCapture:
    """Remember each ``set``; count up in pixels while it ``changes``, fail unless it ``works``."""

    def __init__(self):
        self.asked = []
        self.values = {}
        self.refuses = set()
        self.opens = self.works = self.changes = True
        self.count = self.released = 0
        self.frame = np.zeros((48, 64, 3), np.uint8)
        self.frame[:, :4] = 255  # a mark at the left edge

    def isOpened(self):  # noqa: N802
        return self.opens

    def set(self, prop, value):
        self.asked.append((prop, value))
        if prop not in self.refuses:
            self.values[prop] = value
        return prop not in self.refuses

    def get(self, prop):
        return self.values.get(prop, 0.0)

    def read(self):
        time.sleep(0.002)
        self.count += self.changes
        self.frame[:, 4:, 0] = self.count % 250  # blue in OpenCV's order
        return (True, self.frame.copy()) if self.works else (False, None)

    def release(self):
        self.released += 1


@contextmanager
def one_request(answer=b""):
    """Serve one client on loopback: its address, and the request once it has been answered."""
    requests = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            connection, _ = listener.accept()
            with connection:
                requests.append(connection.recv(4096))
                connection.sendall(answer)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield "{}:{}".format(*listener.getsockname()), requests
        thread.join(30.0)


RETURNS = {
    "none": None,
    "text": "frames",
    "no array": [Stamped(0, "frame")],
    "other": [Stamped(0, np.zeros(9))],
}


COUNTING = tuple(np.arange(1000).reshape(-1, 1))


class ScriptedSource(SampleSource):
    """Give ``samples`` over and over, one every 3 ms, in the ``mode`` that a test sets."""

    def __init__(self, samples=COUNTING):
        super().__init__("scripted")
        self._samples = cycle(samples)
        self._last = next(self._samples)
        self.mode = "live"
        self.opened = 0
        self.closed = 0
        self.returns = threading.Event()

    def _connect(self, undo):
        if self.mode == "bug":
            raise ZeroDivisionError
        if self.mode == "gone":
            raise LostSensorError("scripted: expected it, got nothing. Plug it in.")
        self.opened += 1
        undo.callback(self._count_closing)

    def _count_closing(self):
        self.closed += 1
        if self.mode == "bug":
            raise ZeroDivisionError

    def read(self):
        if self.mode == "gone":
            raise LostSensorError("scripted: expected data, got an unplugged cable. Plug it in.")
        if self.mode in RETURNS:
            return RETURNS[self.mode]
        if self.mode == "bug":
            raise ZeroDivisionError
        if self.mode == "hangs":
            self.returns.wait()
        time.sleep(0.003)
        if self.mode == "silent":
            return []
        self._last = self._last if self.mode == "frozen" else next(self._samples)
        self.counts.samples += 1
        return [Stamped(now_ns(), self._last)]
