"""Messages inside MCAP files → numbers and pictures: JSON or protobuf, ROS-like or flat wrenches, images or video."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np

from uniforce_datasets.readers.files import decode_picture, require
from uniforce_vtla.errors import DatasetError, expected

VIDEO_FORMATS = {"h264": "h264", "h265": "hevc", "av1": "av1", "vp9": "vp9"}  # foxglove's names → PyAV's


class Message(NamedTuple):
    """One message and what is needed to decode it."""

    log_ns: int
    topic: str
    encoding: str
    schema_name: str
    schema: bytes
    data: bytes


def read_topics(file: Path) -> dict[str, str]:
    """Return the schema's name by topic; raise DatasetError where the file is truncated."""
    reader = require("mcap.reader")
    with _damage_told(file), file.open("rb") as stream:
        summary = reader.make_reader(stream).get_summary()
        if summary is None:  # a file may go without: then every message is looked at
            return {message.topic: message.schema_name for message in read_messages(file, None)}
        names = {key: schema.name for key, schema in summary.schemas.items()}
        return {channel.topic: names.get(channel.schema_id, "") for channel in summary.channels.values()}


def read_messages(file: Path, topic: str | None) -> Iterator[Message]:
    """Yield the messages of a topic, or of all, in order of time.

    Raises:
        ContractError: the package ``mcap`` is missing.
        DatasetError: the file can't be read, is truncated or damaged.
    """
    reader = require("mcap.reader")
    with _damage_told(file), file.open("rb") as stream:
        records = reader.make_reader(stream, validate_crcs=True).iter_messages(topic)
        for schema, channel, message in records:
            name, content = (schema.name, schema.data) if schema else ("", b"")
            encoding = channel.message_encoding
            yield Message(message.log_time, channel.topic, encoding, name, content, message.data)


@contextmanager
def _damage_told(file: Path) -> Iterator[None]:
    mcap_errors, zstd = require("mcap.exceptions"), require("zstandard")
    damage = (mcap_errors.McapError, zstd.ZstdError, struct.error, RuntimeError, ValueError, EOFError)
    try:
        yield
    except (*damage, OSError) as error:
        do = "Restore it from a copy."
        raise DatasetError(expected(str(file), "a whole MCAP file", error, do)) from error


class MessageDecoder:
    """Turns messages into nested dicts; bytes stay base64 text, as in JSON. Only data is built, never code run."""

    def __init__(self) -> None:
        self._classes: dict[tuple[str, bytes], Any] = {}

    def __call__(self, message: Message) -> dict[str, Any]:
        """Return the message's fields; raise DatasetError for an encoding or content that can't be read."""
        if message.encoding == "json":
            return _from_json(message.data, message.schema_name)
        if message.encoding == "protobuf":
            return self._from_protobuf(message.schema_name, message.schema, message.data)
        came, do = message.encoding or "none", "Convert the file to one of these."
        raise DatasetError(expected(f"messages on {message.topic}", "json or protobuf", came, do))

    def _from_protobuf(self, name: str, schema: bytes, data: bytes) -> dict[str, Any]:
        json_format, message = require("google.protobuf.json_format"), require("google.protobuf.message")
        try:
            kind = self._classes.get((name, schema)) or _message_class(name, schema)
            self._classes[name, schema] = kind
            parsed = kind.FromString(data)
        except (message.DecodeError, KeyError, TypeError) as error:
            raise DatasetError(
                expected(f"message {name}", "protobuf with its schema", error, "Restore the file.")
            ) from error
        return json_format.MessageToDict(
            parsed, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
        )


def _message_class(name: str, schema: bytes) -> Any:
    pools, factory = require("google.protobuf.descriptor_pool"), require("google.protobuf.message_factory")
    files = require("google.protobuf.descriptor_pb2").FileDescriptorSet.FromString(schema)
    pool = pools.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return factory.GetMessageClass(pool.FindMessageTypeByName(name))


def _from_json(data: bytes, name: str) -> dict[str, Any]:
    try:
        fields = json.loads(data)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DatasetError(expected(f"message {name}", "JSON", error, "Restore the file.")) from error
    if not isinstance(fields, dict):
        raise DatasetError(expected(f"message {name}", "a JSON object", type(fields).__name__, "Restore it."))
    return fields


def force_in(fields: dict[str, Any], where: str) -> np.ndarray:
    """Return (3,) float64 N of a wrench: ``{wrench: {force: {x, y, z}}}``, ``{force: …}`` or ``{fx, fy, fz}``.

    Raises:
        DatasetError: none of these, or not three numbers.
    """
    inner = fields.get("wrench", fields)
    inner = inner.get("force", inner) if isinstance(inner, dict) else inner
    values = None
    for names in (("x", "y", "z"), ("fx", "fy", "fz"), ("Fx", "Fy", "Fz")):
        if isinstance(inner, dict) and all(name in inner for name in names):
            values = [inner[name] for name in names]
    if isinstance(inner, list):
        values = inner[:3]
    numbers = values is not None and len(values) == 3 and all(isinstance(v, int | float) for v in values)
    if not numbers:
        came = sorted(fields) if isinstance(fields, dict) else fields
        wanted = "force with x, y, z, or fx, fy, fz"
        raise DatasetError(expected(f"{where}, wrench message", wanted, f"{came}", "Is it another topic?"))
    return np.array(values, np.float64)


class Pictures:
    """Gel frames of one topic, in order: call with each message, then take the ``rest``."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._codec: Any = None

    def __call__(self, fields: dict[str, Any]) -> Iterator[np.ndarray]:
        """Yield the (H, W, 3) uint8 RGB frames that are complete after this message.

        Raises:
            DatasetError: no picture data, or broken.
        """
        data, kind = _content(fields, self._where), str(fields.get("format", "")).lower()
        if kind not in VIDEO_FORMATS:
            yield decode_picture(data, self._where, colour=True)
            return
        if self._codec is None:
            self._codec = av.CodecContext.create(VIDEO_FORMATS[kind], "r")
        yield from self._decoded(av.Packet(data))

    def rest(self) -> Iterator[np.ndarray]:
        """Yield frames a video decoder still holds back."""
        if self._codec is not None:
            yield from self._decoded(None)

    def _decoded(self, packet: av.Packet | None) -> Iterator[np.ndarray]:
        try:
            frames = self._codec.decode(packet)
        except av.error.FFmpegError as error:
            raise DatasetError(
                expected(f"{self._where}, video", "whole frames", error, "Restore it from a copy.")
            ) from error
        for frame in frames:
            yield frame.to_ndarray(format="rgb24")


def _content(fields: dict[str, Any], where: str) -> bytes:
    data = fields.get("data")
    try:
        if isinstance(data, str):
            return base64.b64decode(data, validate=True)
        if isinstance(data, list):
            return bytes(data)  # some JSON writers list the bytes
    except (binascii.Error, ValueError, TypeError) as error:
        raise DatasetError(expected(f"{where}, image data", "base64", error, "Restore the file.")) from error
    raise DatasetError(expected(f"{where}, image", "a field data", sorted(fields), "Is it another topic?"))
