"""A tactile camera as MJPEG on loopback: ``python -m uniforce_robots.standins.mjpeg --help``."""

import sys
from dataclasses import dataclass

import cv2
import numpy as np

from uniforce_robots.standins.control import StandInServer
from uniforce_robots.standins.plugs import Sockets
from uniforce_robots.standins.scene import Scene, frame_cycle
from uniforce_vtla.arguments import parse

BOUNDARY = b"uniforceframe"
KIND = b"multipart/x-mixed-replace; boundary=" + BOUNDARY
WELCOME = b"HTTP/1.0 200 OK\r\nContent-Type: " + KIND + b"\r\n\r\n"
JPEG_QUALITY = 90


@dataclass
class MjpegConfig(Scene):
    """Show a simulated GelSight or TacTip as an MJPEG stream on loopback.

    Example: python -m uniforce_robots.standins.mjpeg sensor=gelsight rate_hz=30
    """

    sensor: str = "tactip"  # gelsight | tactip
    rate_hz: float = 30.0  # frames per second
    fault: str = "none"  # what is broken from the start
    port: int = 0  # 0 = any free one


def encode(frame: np.ndarray) -> bytes:
    """Return the JPEG of an (H, W, 3) uint8 RGB frame."""
    bgr = cv2.cvtColor(frame, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def part(jpeg: bytes) -> bytes:
    """Return one part of the stream."""
    header = b"--%s\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n"
    return header % (BOUNDARY, len(jpeg)) + jpeg + b"\r\n"


class MjpegStandIn(StandInServer):
    """The streamer: one simulated camera, any number of clients."""

    faults = ("stop", "stall", "freeze", "size", "garbage")

    def __init__(self, config: MjpegConfig) -> None:
        cv2.setNumThreads(1)
        frames = frame_cycle(config.sensor, config, config.rate_hz)
        self._jpegs = [encode(frame) for frame in frames]
        self._small = encode(cv2.resize(frames[0], (320, 240)))
        self._server = Sockets(("127.0.0.1", config.port), lambda client: WELCOME)
        super().__init__(
            self._server, "http://{}:{}/stream".format(*self._server.where), config, config.rate_hz
        )

    def beat(self) -> None:
        """Send a frame; the cycle begins, in free air, with the first client."""
        if self._server.clients and self.fault not in ("stall", "stop"):
            self.plug.send(part(self._jpeg(self.next_step())))

    def _jpeg(self, step: int) -> bytes:
        if self.fault == "garbage" and step % 2:
            return self.rng.bytes(2000)
        if self.fault == "size":
            return self._small
        return self._jpegs[step % len(self._jpegs)]


if __name__ == "__main__":
    sys.exit(MjpegStandIn(parse(MjpegConfig)).run())
