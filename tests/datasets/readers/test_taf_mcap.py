from __future__ import annotations

import base64
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import IndexType, Writer

from uniforce_datasets.readers import McapConfig, force_set, read_taf_mcap
from uniforce_datasets.readers.mcap_messages import Message, MessageDecoder, Pictures, force_in
from uniforce_vtla import Canonicalizer
from uniforce_vtla.errors import ContractError, DatasetError

GEL, WRENCH = "/tactile-camera", "/force-torque"
FRAME_NS = 33_333_333
Wire = Callable[[dict[str, Any]], bytes]


def png(frame: np.ndarray) -> str:
    return base64.b64encode(cv2.imencode(".png", frame[..., ::-1])[1].tobytes()).decode()


def image_message(frame: np.ndarray) -> dict[str, Any]:
    return {"timestamp": {"sec": 0, "nsec": 0}, "frame_id": "gel", "data": png(frame), "format": "png"}


def wrench_message(force_N: np.ndarray) -> dict[str, Any]:
    x, y, z = (float(v) for v in force_N * (1, 1, -1))  # the rig's Fz is negative in compression
    return {"force": {"x": x, "y": y, "z": z}, "torque": {"x": 0.1, "y": 0.1, "z": 0.1}}


def write_mcap(
    path: Path,
    frames: list[dict],
    wrenches: list[dict],
    gel: str = GEL,
    wrench: str = WRENCH,
    plot: str = f"{WRENCH}.plot",
) -> Path:
    """Write JSON messages; the wrench comes a little after its frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, schema, messages, offset in (
            (gel, "foxglove.CompressedImage", frames, 0),
            (wrench, "Wrench", wrenches, 2_000_000),
            ("/pressure-map", "foxglove.CompressedImage", frames[:1], 0),
            (plot, "Plot", wrenches[:1], 0),
        ):
            schema_id = writer.register_schema(schema, "jsonschema", b"{}")
            channel = writer.register_channel(topic, "json", schema_id)
            for index, fields in enumerate(messages):
                at = index * FRAME_NS + offset
                writer.add_message(channel, at, json.dumps(fields).encode(), at)
        writer.finish()
    return path


@pytest.fixture(scope="session")
def messages(gel_run: Any) -> tuple[list[dict], list[dict]]:
    return [image_message(f) for f in gel_run.raw], [wrench_message(f) for f in gel_run.force_N]


@pytest.fixture
def run_file(tmp_path: Path, messages: tuple[list[dict], list[dict]]) -> Path:
    return write_mcap(tmp_path / "cube" / "run_07.mcap", *messages)


def test_frames_and_forces_come_back(run_file: Path, gel_run: Any) -> None:
    found = force_set(run_file.parents[1])
    (recording,) = found
    assert found.format == "taf_mcap" and str(recording) == "gelsight_mini/cube/run_07"
    pairs = [Canonicalizer("gelsight").pair(gel_run.raw[0], raw, "left") for raw in gel_run.raw]
    assert np.array_equal(recording.reference, pairs[0].reference)
    assert np.array_equal(recording.frames, np.stack([pair.current for pair in pairs]))
    assert np.array_equal(recording.force_N, gel_run.force_N)


def test_each_frame_takes_the_nearest_wrench(tmp_path: Path, messages: Any, gel_run: Any) -> None:
    """Wrenches at twice the rate, the extra ones far from any frame in time and in force."""
    dense = [m for wrench in messages[1] for m in (wrench, wrench_message(np.array([0, 0, 15.0])))]
    path = tmp_path / "cube" / "run.mcap"
    path.parent.mkdir()
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        gel = writer.register_channel(GEL, "json", writer.register_schema("i", "jsonschema", b"{}"))
        wrench = writer.register_channel(WRENCH, "json", writer.register_schema("w", "jsonschema", b"{}"))
        for index, fields in enumerate(messages[0]):
            writer.add_message(gel, index * FRAME_NS, json.dumps(fields).encode(), 0)
        for index, fields in enumerate(dense):
            at = index * FRAME_NS // 2 + 3_000_000
            writer.add_message(wrench, at, json.dumps(fields).encode(), 0)
        writer.finish()
    (recording,) = read_taf_mcap(tmp_path)
    assert np.array_equal(recording.force_N, gel_run.force_N)


def test_a_file_without_summary_is_read(tmp_path: Path, messages: Any, gel_run: Any) -> None:
    bare = IndexType.NONE
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = Writer(
            stream,
            index_types=bare,
            repeat_channels=False,
            repeat_schemas=False,
            use_statistics=False,
            use_summary_offsets=False,
        )
        writer.start()
        schema_id = writer.register_schema("any", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema_id) for topic in (GEL, WRENCH)]
        for index, both in enumerate(zip(*messages, strict=True)):
            for channel, fields in zip(channels, both, strict=True):
                writer.add_message(channel, index * FRAME_NS, json.dumps(fields).encode(), 0)
        writer.finish()
    (recording,) = read_taf_mcap(tmp_path)
    assert np.array_equal(recording.force_N, gel_run.force_N)


def test_a_video_that_begins_too_late_is_refused(tmp_path: Path, messages: Any) -> None:
    """No picture comes out of a stream without its first key frame, though there is a message per frame."""
    cut = [{"format": "h264", "data": base64.b64encode(b"\0\0\0\1\x09\x10").decode()} for _ in messages[0]]
    write_mcap(tmp_path / "run.mcap", cut, messages[1])
    with pytest.raises(DatasetError, match=r"frame 0 for the reference|video"):
        list(read_taf_mcap(tmp_path))


def proto_files() -> descriptor_pb2.FileDescriptorSet:
    """An image and a wrench as protobuf schemas, built here."""
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="t", syntax="proto3")
    kinds = {"double": 1, "string": 9, "bytes": 12}
    for name, fields in {
        "Vector": [("x", "double"), ("y", "double"), ("z", "double")],
        "Image": [("data", "bytes"), ("format", "string")],
        "Wrench": [("force", "Vector")],
    }.items():
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields, 1):
            added = message.field.add(name=field, number=number, label=1)
            added.type = kinds.get(kind, 11)
            if kind not in kinds:
                added.type_name = f".t.{kind}"
    return descriptor_pb2.FileDescriptorSet(file=[file])


def test_protobuf_messages_are_read(tmp_path: Path, gel_run: Any) -> None:
    schema = proto_files()
    pool = descriptor_pool.DescriptorPool()
    pool.Add(schema.file[0])
    kinds = {
        n: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"t.{n}")) for n in ("Image", "Wrench")
    }
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels = {}
        for name, topic in (("Image", GEL), ("Wrench", WRENCH)):
            schema_id = writer.register_schema(f"t.{name}", "protobuf", schema.SerializeToString())
            channels[name] = writer.register_channel(topic, "protobuf", schema_id)
        for index, (frame, force) in enumerate(zip(gel_run.raw, gel_run.force_N, strict=True)):
            wrench = kinds["Wrench"](force=wrench_message(force)["force"])
            image = kinds["Image"](data=base64.b64decode(png(frame)), format="png")
            for name, message in (("Image", image), ("Wrench", wrench)):
                writer.add_message(channels[name], index * FRAME_NS, message.SerializeToString(), 0)
        writer.finish()
    (recording,) = read_taf_mcap(tmp_path)
    assert np.array_equal(
        recording.force_N, gel_run.force_N
    )  # frame 0 is all zero, which protobuf leaves out
    assert len(recording.frames) == len(gel_run.raw)


def test_compressed_video_is_decoded_in_order() -> None:
    levels = [40, 90, 140, 190]
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.framerate = 64, 48, "yuv420p", 30
    encoder.options = {"crf": "0", "tune": "zerolatency", "x264-params": "annexb=1:repeat-headers=1"}
    packets = []
    for level in [*levels, None]:
        frame = None
        if level is not None:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), format="rgb24")
        packets += [bytes(packet) for packet in encoder.encode(frame)]
    pictures, frames = Pictures("test"), []
    for data in packets:
        frames += list(pictures({"format": "h264", "data": base64.b64encode(data).decode()}))
    frames += list(pictures.rest())
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 4
    assert [abs(int(frame.mean()) - level) <= 3 for frame, level in zip(frames, levels, strict=True)] == [
        True
    ] * 4


@pytest.mark.parametrize(
    "fields",
    [
        {"wrench": {"force": {"x": 1, "y": 2.0, "z": 3}, "torque": {}}},
        {"force": {"x": 1, "y": 2, "z": 3}},
        {"fx": 1, "fy": 2, "fz": 3, "tx": 4},
        {"force": [1, 2, 3]},
        {"wrench": [1, 2, 3, 4, 5, 6]},
    ],
)
def test_forms_of_a_wrench(fields: dict[str, Any]) -> None:
    assert force_in(fields, "run").tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    "fields", [{}, {"force": {"x": 1}}, {"force": "1,2,3"}, {"fx": 1, "fy": 2, "fz": "3"}]
)
def test_what_is_no_wrench_is_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(DatasetError, match="force with x, y, z"):
        force_in(fields, "run")


@pytest.mark.parametrize("fields", [{}, {"data": 3}, {"data": "no base64!"}, {"data": ""}, {"data": "AAAA"}])
def test_what_is_no_picture_is_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(DatasetError):
        list(Pictures("run")({"format": "png"} | fields))


@pytest.mark.parametrize(
    "message",
    [
        Message(0, "/t", "cdr", "x", b"", b""),
        Message(0, "/t", "json", "x", b"", b"{"),
        Message(0, "/t", "json", "x", b"", b"[1]"),
        Message(0, "/t", "protobuf", "t.None", b"", b""),
        Message(0, "/t", "protobuf", "t.Wrench", proto_files().SerializeToString(), b"\xff\xff"),
    ],
)
def test_messages_that_cant_be_decoded_are_refused(message: Message) -> None:
    with pytest.raises(DatasetError):
        MessageDecoder()(message)


def test_unclear_topics_are_listed(tmp_path: Path, messages: Any) -> None:
    write_mcap(tmp_path / "run.mcap", *messages, gel="/camera", wrench="/left", plot="/pressure.plot")
    with pytest.raises(DatasetError, match=r"tactile_topic.*/camera \(foxglove\.CompressedImage\).*/left"):
        list(read_taf_mcap(tmp_path))
    with pytest.raises(DatasetError, match="wrench_topic"):
        list(read_taf_mcap(tmp_path, McapConfig(tactile_topic="/camera")))
    assert len(list(read_taf_mcap(tmp_path, McapConfig("/camera", "/left")))) == 1


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
def test_a_truncated_file_is_refused(run_file: Path, keep: float) -> None:
    content = run_file.read_bytes()
    run_file.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(DatasetError, match="a whole MCAP file"):
        list(read_taf_mcap(run_file.parent))


def test_flipped_bytes_are_noticed(run_file: Path) -> None:
    content = bytearray(run_file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    run_file.write_bytes(content)
    with pytest.raises(DatasetError):
        list(read_taf_mcap(run_file.parent))


@pytest.mark.parametrize("cut", [slice(0, 3), slice(0, 0)])
def test_frames_without_a_wrench_are_refused(tmp_path: Path, messages: Any, cut: slice) -> None:
    write_mcap(tmp_path / "run.mcap", messages[0], messages[1][cut])
    with pytest.raises(DatasetError, match=r"within 0\.02 s of each of 6 frames|6 frames and 0 wrenches"):
        list(read_taf_mcap(tmp_path))


def test_nan_force_is_refused(tmp_path: Path, messages: Any) -> None:
    wrenches = [*messages[1][:2], {"fx": float("nan"), "fy": 0.0, "fz": 0.0}, *messages[1][3:]]
    write_mcap(tmp_path / "run.mcap", messages[0], wrenches)
    with pytest.raises(DatasetError, match="NaN or inf in row 2"):
        list(read_taf_mcap(tmp_path))


def test_a_link_that_leads_outside_is_refused(run_file: Path) -> None:
    (run_file.parent / "own").mkdir()
    (run_file.parent / "own" / "linked.mcap").symlink_to(run_file)
    with pytest.raises(DatasetError, match="a path inside"):
        list(read_taf_mcap(run_file.parent / "own"))


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"\*\.mcap"):
        list(read_taf_mcap(tmp_path))


def test_the_missing_package_is_named(run_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(ContractError, match=r"pip install lerobot_policy_pi05_uniforce\[readers\]"):
        list(read_taf_mcap(run_file.parent))
