"""What reads bytes from a device: each with a stream that is right, to be injured."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, PacketHandler, PortHandler
from fci_client import RawArm, RawClient, RawHand
from mutations import chunks
from standins import spacemouse
from standins.gello import status
from standins.xela import frame, greeting, message
from websockets.frames import Opcode

from uniforce_robots.sensors.mjpeg import MAX_HEADER_BYTES, MAX_JPEG_BYTES, MultipartJpeg, decode_bgr
from uniforce_robots.sensors.uskin_server import MAX_MESSAGE_BYTES, XelaMessages, read_message
from uniforce_robots.sensors.uskin_slcan import MAX_TAIL_BYTES, SlcanScans
from uniforce_robots.standins.fci.protocol import (
    ARM_HEADER,
    ARM_VERSION,
    HAND_HEADER,
    HAND_STATE_BYTES,
    HAND_VERSION,
    STATE_BYTES,
    STATE_FLOAT_COUNT,
    ArmCommand,
    HandCommand,
    HandState,
    Header,
    Message,
    MoveStatus,
    ProtocolError,
    RobotState,
)
from uniforce_robots.standins.mjpeg import encode, part
from uniforce_robots.standins.slcan import scan_lines
from uniforce_robots.teleop.gello import POSITION_BYTES, PRESENT_POSITION
from uniforce_robots.teleop.spacemouse import LARGEST_COUNT, SpaceMouseSource
from uniforce_vtla.errors import SensorError, TeleoperatorError


@dataclass(frozen=True)
class ByteTarget:
    """A parser, bytes it accepts, and the errors it may raise over others."""

    feed: Callable[[np.random.Generator, bytes], None]
    seed: bytes
    typed: tuple[type[Exception], ...] = (SensorError,)
    refuses: bool = True  # False for a reader that resynchronises instead


def feed_slcan(rng: np.random.Generator, data: bytes) -> None:
    reader = SlcanScans()
    for chunk in chunks(rng, data):
        for scan in reader.feed(chunk):
            assert scan.shape == (16, 3) and scan.dtype == np.uint16
        assert len(reader._tail) <= MAX_TAIL_BYTES


def feed_websocket(rng: np.random.Generator, data: bytes) -> None:
    client = XelaMessages("127.0.0.1", 1, "fuzz")
    client.feed(greeting(b"".join(client.protocol.data_to_send())))
    for chunk in filter(None, chunks(rng, data)):
        for text in client.feed(chunk):
            read_message(text, "1", "fuzz")
        waiting = len(client.protocol.reader.buffer) + sum(map(len, client._parts))
        assert waiting <= MAX_MESSAGE_BYTES + len(data)


def feed_json(rng: np.random.Generator, data: bytes) -> None:
    _, counts = read_message(data.decode(errors="replace"), "1", "fuzz")
    assert counts is None or counts.shape == (16, 3)


def feed_mjpeg(rng: np.random.Generator, data: bytes) -> None:
    reader = MultipartJpeg("fuzz")
    for chunk in chunks(rng, data):
        for got in reader.feed(chunk):
            assert len(got) <= MAX_JPEG_BYTES
            decode_bgr(got)
        assert len(reader._buffer) <= MAX_JPEG_BYTES + MAX_HEADER_BYTES + len(data)


class MotorPort(PortHandler):
    """A port of the SDK whose motors have answered already."""

    def __init__(self, received: list[bytes]) -> None:
        super().__init__("fuzz")
        self._received = received

    def readPort(self, length: int) -> bytes:  # noqa: N802
        chunk = self._received.pop(0) if self._received else b""
        if len(chunk) > length:
            self._received.insert(0, chunk[length:])
        return chunk[:length]

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self._received


def feed_dynamixel(rng: np.random.Generator, data: bytes) -> None:
    port = MotorPort([chunk for chunk in chunks(rng, data) if chunk])
    group = GroupSyncRead(port, PacketHandler(2.0), PRESENT_POSITION, POSITION_BYTES)
    for motor in range(1, 9):
        group.addParam(motor)
    if group.rxPacket() == COMM_SUCCESS:
        assert all(len(answer) <= POSITION_BYTES for answer in group.data_dict.values())


def feed_spacemouse(rng: np.random.Generator, data: bytes) -> None:
    reader = SpaceMouseSource()
    for report in chunks(rng, data):
        reader.feed(report)
        assert np.abs(reader.state).max() <= LARGEST_COUNT


class Wire:
    """A socket that has received something already."""

    def __init__(self, received: list[bytes]) -> None:
        self._received = received

    def recv(self, _: int) -> bytes:
        return self._received.pop(0) if self._received else b""

    def recvfrom(self, _: int) -> tuple[bytes, tuple[str, int]]:
        return self.recv(0), ("127.0.0.1", 1)

    def sendall(self, _: bytes) -> None:
        return

    def getsockname(self) -> tuple[str, int]:
        return "127.0.0.1", 1


def connected[Client: RawClient](
    kind: type[Client], header: Header, rng: np.random.Generator, answers: bytes, datagram: bytes
) -> Client:
    tcp, udp = Wire([chunk for chunk in chunks(rng, answers) if chunk]), Wire([datagram])
    return kind.on(tcp, udp, header)  # type: ignore[arg-type]


def feed_arm(rng: np.random.Generator, data: bytes) -> None:
    """Connect, one state, a motion that starts and ends, a setter."""
    client = connected(RawArm, ARM_HEADER, rng, data[:-STATE_BYTES], data[-STATE_BYTES:])
    client.greet(ARM_VERSION)
    assert client.state().floats.shape == (STATE_FLOAT_COUNT,)
    client.move()
    for _ in range(2):
        assert client.receive().command_id >= 0
    client.ask(ArmCommand.STOP_MOVE)


def feed_hand(rng: np.random.Generator, data: bytes) -> None:
    """Connect, one state, two commands."""
    client = connected(RawHand, HAND_HEADER, rng, data[:-HAND_STATE_BYTES], data[-HAND_STATE_BYTES:])
    client.greet(HAND_VERSION)
    assert isinstance(client.state().is_grasped, bool)
    for command in (HandCommand.HOMING, HandCommand.STOP):
        assert 0 <= client.status_of(command) < 65_536


SCANS = np.random.default_rng(0).integers(0, 65_536, (2, 16, 3)).astype(np.uint16)
JPEG = encode(np.random.default_rng(1).integers(0, 255, (16, 24, 3), dtype=np.uint8))
HTTP = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=uniforceframe\r\n\r\n"
JSON = message(7, SCANS[0], "null").encode()
ARM_ANSWERS = (
    Message(ArmCommand.CONNECT, 1, b"\0" + ARM_VERSION.to_bytes(2, "little")),
    Message(ArmCommand.MOVE, 2, bytes([MoveStatus.MOTION_STARTED])),
    Message(ArmCommand.MOVE, 2, bytes([MoveStatus.SUCCESS])),
    Message(ArmCommand.STOP_MOVE, 3, b"\0"),
)
HAND_ANSWERS = (
    Message(HandCommand.CONNECT, 1, b"\0\0" + HAND_VERSION.to_bytes(2, "little")),
    Message(HandCommand.HOMING, 2, b"\0\0"),
    Message(HandCommand.STOP, 3, b"\0\0"),
)
ARM = b"".join(map(ARM_HEADER.encode, ARM_ANSWERS)) + RobotState(9, np.zeros(STATE_FLOAT_COUNT)).encode()
HAND = b"".join(map(HAND_HEADER.encode, HAND_ANSWERS)) + HandState(9, 0.04, 0.08, False, 30).encode()
FCI_ERRORS = (ProtocolError, ConnectionError)
BYTE_TARGETS = {
    "slcan": ByteTarget(
        feed_slcan, b"\r\rV1013\r" + b"".join(chain.from_iterable(scan_lines(SCANS, 0))), refuses=False
    ),
    "websocket": ByteTarget(
        feed_websocket,
        frame(Opcode.TEXT, b'{"message": "Welcome"}')
        + frame(Opcode.PING, b"ping")
        + frame(Opcode.TEXT, JSON[:300], False)
        + frame(Opcode.CONT, JSON[300:]),
    ),
    "json": ByteTarget(feed_json, JSON),
    "mjpeg": ByteTarget(feed_mjpeg, HTTP + 3 * part(JPEG)),
    "dynamixel": ByteTarget(
        feed_dynamixel,
        b"".join(status(i, bytes([i, 255, 255, 253]), 0) for i in range(1, 9)),
        (TeleoperatorError,),
        refuses=False,
    ),
    "spacemouse": ByteTarget(
        feed_spacemouse,
        b"".join(spacemouse.reports((1, -350, 0, 9, 350, -2), 3, "three")),
        (TeleoperatorError,),
        refuses=False,
    ),
    "fci_arm": ByteTarget(feed_arm, ARM, FCI_ERRORS),
    "fci_hand": ByteTarget(feed_hand, HAND, FCI_ERRORS),
}
