"""MJPEG over HTTP: any cutting of the stream, servers of all habits, and nothing without bounds."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scripted import one_request

from uniforce_robots.sensors import UniforceTactileCameraConfig
from uniforce_robots.sensors.faults import ProtocolError
from uniforce_robots.sensors.mjpeg import MultipartJpeg, StreamSource, decode_bgr
from uniforce_robots.standins.mjpeg import encode, part

HEADER = (
    b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=uniforceframe\r\n\r\n"
)
IMAGES = [bytes([0xFF, 0xD8, i]) + b"x" * (50 + i) for i in range(4)]
STREAM = HEADER + b"".join(part(image) for image in IMAGES) + b"--uniforceframe\r\n"


@examples(60)
@given(cuts=st.lists(st.integers(0, len(STREAM)), max_size=20))
def test_how_the_stream_is_cut_makes_no_difference(cuts):
    reader = MultipartJpeg("cam")
    edges = [0, *sorted(cuts), len(STREAM)]
    assert [
        image for a, b in itertools.pairwise(edges) for image in reader.feed(STREAM[a:b])
    ] == IMAGES


@pytest.mark.parametrize(
    "boundary", [b'"uniforceframe"', b"--uniforceframe", b"uniforceframe; charset=x"]
)
def test_boundaries_as_servers_write_them(boundary):
    data = STREAM.replace(b"boundary=uniforceframe", b"boundary=" + boundary, 1)
    assert len(MultipartJpeg("cam").feed(data)) == 4


@pytest.mark.parametrize(
    "answer, says",
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "404"),
        (b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n", "text/html"),
        (b"HTTP/1.0 200 OK\r\n\r\n", "multipart"),
        (b"SSH-2.0-OpenSSH\r\n\r\n", "SSH"),
        (HEADER + b"--other\r\n\r\n", "boundary"),
        (HEADER + b"--uniforceframe\r\nContent-Length: -5\r\n\r\n", "-5"),
        (HEADER + b"--uniforceframe\r\nContent-Length: 99999999999\r\n\r\n", "99999999999"),
        (b"H" * 9000, "header"),
        (HEADER + b"--uniforceframe\r\nContent-Type: image/jpeg\r\n\r\n", "Content-Length"),
    ],
)
def test_what_is_no_mjpeg_stream_is_a_typed_error(answer, says):
    with pytest.raises(ProtocolError, match=says):
        MultipartJpeg("cam").feed(answer)


def test_only_a_jpeg_of_sensible_size_is_decoded():
    jpeg = encode(np.full((48, 64, 3), 90, np.uint8))
    image = decode_bgr(jpeg)
    assert image.shape == (48, 64, 3)
    at = jpeg.index(b"\xff\xc0") + 5
    assert decode_bgr(jpeg[:at] + b"\xff\xff\xff\xff" + jpeg[at + 4 :]) is None  # 65,535 px a side
    assert all(decode_bgr(data) is None for data in (b"", b"\xff\xd8", b"GIF89a"))


def test_a_login_in_the_address_is_sent_and_never_part_of_the_path():
    with one_request() as (address, requests):
        login = f"http://anna:s3%20cret@{address}/video"
        source = StreamSource(UniforceTactileCameraConfig(source=login))
        source.open()
        source.close()
        assert "s3" not in source.name
    assert requests[0].startswith(b"GET /video HTTP/1.0\r\n")
    assert b"Authorization: Basic YW5uYTpzMyBjcmV0\r\n" in requests[0]  # anna:s3 cret
