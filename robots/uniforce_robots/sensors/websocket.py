"""A small WebSocket client (RFC 6455) on the standard library: text in, pings answered, closing said aloud.

Only what reading a sensor server needs: no extensions, no sending of data, every buffer bounded.
"""

from __future__ import annotations

import base64
import hashlib
import os
import socket
import time
from typing import NamedTuple

from uniforce_robots.sensors.backlog import Backlog
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_vtla.errors import expected

GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455, section 1.3
CONTINUATION, TEXT, BINARY, CLOSE, PING, PONG = 0x0, 0x1, 0x2, 0x8, 0x9, 0xA
MAX_CONTROL_BYTES = 125  # section 5.5
MAX_MESSAGE_BYTES = 1 << 20  # a server message of 16 taxels has about 2 KB
MAX_HEADER_BYTES = 8192
CONNECT_S = 2.0
CHUNK_BYTES = 1 << 16


class Frame(NamedTuple):
    """One frame: opcode and unmasked payload."""

    is_last: bool
    opcode: int
    payload: bytes


class Message(NamedTuple):
    """A whole message or a control frame."""

    opcode: int
    payload: bytes


class FrameReader:
    """Server bytes → messages; no I/O.

    Args:
        name: how errors call the sensor.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._buffer = bytearray()
        self._parts: list[bytes] = []
        self._size = 0
        self._opcode = 0  # of the fragmented message being collected; 0 = none

    def feed(self, chunk: bytes) -> list[Message]:
        """Return the messages and control frames that ``chunk`` completes.

        Raises:
            ProtocolError: reserved bits or opcodes, a masked or oversized frame, fragments out of order.
        """
        self._buffer += chunk
        messages = []
        while (frame := self._take_frame()) is not None:
            message = self._assemble(frame)
            if message is not None:
                messages.append(message)
        return messages

    def _take_frame(self) -> Frame | None:
        buffer = self._buffer
        if len(buffer) < 2:
            return None
        if buffer[0] & 0x70 or buffer[1] & 0x80:
            raise self._error("plain server frames (section 5.2)", "reserved bits or a mask")
        size, start = buffer[1] & 0x7F, 2
        if size > MAX_CONTROL_BYTES:
            start += 2 if size == 126 else 8
            if len(buffer) < start:
                return None
            size = int.from_bytes(buffer[2:start])
        self._check_size(buffer[0] & 0x0F, bool(buffer[0] & 0x80), size)
        if len(buffer) < start + size:
            return None
        frame = Frame(bool(buffer[0] & 0x80), buffer[0] & 0x0F, bytes(buffer[start : start + size]))
        del buffer[: start + size]
        return frame

    def _check_size(self, opcode: int, is_last: bool, size: int) -> None:
        if opcode >= CLOSE and (size > MAX_CONTROL_BYTES or not is_last):
            raise self._error("short, whole control frames (section 5.5)", f"{size} bytes, last={is_last}")
        if self._size + size > MAX_MESSAGE_BYTES:
            raise self._error(f"messages of at most {MAX_MESSAGE_BYTES} bytes", f"{self._size + size}")

    def _assemble(self, frame: Frame) -> Message | None:
        if frame.opcode in (CLOSE, PING, PONG):
            return Message(frame.opcode, frame.payload)
        if frame.opcode not in (CONTINUATION, TEXT, BINARY):
            raise self._error("a known opcode", hex(frame.opcode))
        if (frame.opcode == CONTINUATION) != bool(self._opcode):
            raise self._error("fragments in order (section 5.4)", f"opcode {frame.opcode}")
        self._opcode = self._opcode or frame.opcode
        if frame.payload:  # endless empty fragments must not pile up
            self._parts.append(frame.payload)
        self._size += len(frame.payload)
        if not frame.is_last:
            return None
        message = Message(self._opcode, b"".join(self._parts))
        self._parts, self._size, self._opcode = [], 0, 0
        return message

    def _error(self, wanted: str, came: str) -> ProtocolError:
        do = "Is this a WebSocket server that speaks RFC 6455?"
        return ProtocolError(expected(self._name, wanted, came, do))


class WebSocket:
    """A connection to ``host:port``.

    Args:
        host: name or address.
        port: e.g. 5000.
        name: how errors call the sensor.

    Raises:
        LostSensorError: nobody there.
        ProtocolError: whoever is there speaks something else.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        self._name = name
        self._reader = FrameReader(name)
        self._backlog = Backlog(name, CHUNK_BYTES)
        self._said_farewell = False
        try:
            self._socket = socket.create_connection((host, port), CONNECT_S)
        except OSError as error:
            do = "Is the server running, and at this address (not only on its LAN address)?"
            raise LostSensorError(expected(name, f"a server at {host}:{port}", error, do)) from error
        try:
            self._early = self._shake_hands(host, port)
        except (LostSensorError, ProtocolError):
            self._socket.close()
            raise

    def receive(self, timeout_s: float) -> list[str]:
        """Return the text messages that came within ``timeout_s``, maybe none; answers pings.

        Raises:
            LostSensorError: closed, by farewell or without.
            ProtocolError: broken frames, or text that isn't UTF-8.
            StaleSensorError: messages come faster than they are read.
        """
        if self._said_farewell:
            raise self._lost("a farewell from the server")
        chunk, self._early = self._early or self._receive(timeout_s), b""
        texts = self._take(chunk)
        while not self._said_farewell and self._backlog.more_waits(len(chunk)):
            texts += self._take(chunk := self._receive(0.0))
        if self._said_farewell and not texts:  # what came with the farewell is still delivered
            raise self._lost("a farewell from the server")
        return texts

    def _take(self, chunk: bytes) -> list[str]:
        """Return the texts that ``chunk`` completes; answer what wants an answer."""
        texts = []
        for message in self._reader.feed(chunk):
            if message.opcode == TEXT:
                texts.append(self._decode(message.payload))
            elif message.opcode == PING:
                self._send(PONG, message.payload)
            elif message.opcode == CLOSE:
                self._send(CLOSE, message.payload[:2])
                self._said_farewell = True
                break
        return texts

    def close(self) -> None:
        """Say goodbye, as far as it is still heard, and close."""
        try:
            self._send(CLOSE, (1000).to_bytes(2))
        except LostSensorError:
            pass  # the other side went first
        finally:
            self._socket.close()

    def _shake_hands(self, host: str, port: int) -> bytes:
        """Upgrade the connection (section 4); return what came behind the answer."""
        key = base64.b64encode(os.urandom(16))
        request = (
            f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key.decode()}\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        self._write(request.encode())
        header, early = self._answer()
        accept = base64.b64encode(hashlib.sha1(key + GUID).digest())
        lines = header.split(b"\r\n")
        fields = {k.strip().lower(): v.strip() for k, _, v in (line.partition(b":") for line in lines[1:])}
        if lines[0].split(b" ")[1:2] != [b"101"] or fields.get(b"sec-websocket-accept") != accept:
            do = "Is this xela_server's port?"
            came = lines[0][:60].decode("latin-1")
            raise ProtocolError(expected(self._name, "a WebSocket handshake (101)", came, do))
        return early

    def _answer(self) -> tuple[bytes, bytes]:
        answer, deadline = b"", time.monotonic() + CONNECT_S
        while b"\r\n\r\n" not in answer:
            left_s = deadline - time.monotonic()
            if left_s <= 0 or len(answer) > MAX_HEADER_BYTES:
                do = "Is this a WebSocket server?"
                raise ProtocolError(expected(self._name, "a handshake", "none in time", do))
            answer += self._receive(left_s)
        header, _, early = answer.partition(b"\r\n\r\n")
        return header, early

    def _receive(self, timeout_s: float) -> bytes:
        try:
            self._socket.settimeout(max(timeout_s, 1e-3))
            chunk = self._socket.recv(CHUNK_BYTES)
        except TimeoutError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not chunk:
            raise self._lost("the end of the connection")
        return chunk

    def _send(self, opcode: int, payload: bytes) -> None:
        """Send one masked control frame (section 5.3: a client masks everything)."""
        mask = os.urandom(4)
        body = bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))
        self._write(bytes([0x80 | opcode, 0x80 | len(payload)]) + mask + body)

    def _write(self, data: bytes) -> None:
        try:
            self._socket.settimeout(CONNECT_S)
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost(error) from error

    def _decode(self, payload: bytes) -> str:
        try:
            return payload.decode()
        except UnicodeDecodeError as error:
            raise ProtocolError(expected(self._name, "UTF-8 text", error, "Is this xela_server?")) from error

    def _lost(self, came: object) -> LostSensorError:
        do = "Is the server still running? Connecting again."
        return LostSensorError(expected(self._name, "an open connection", came, do))
