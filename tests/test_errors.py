import pytest

from uniforce_vtla.errors import expected, without_credentials


@pytest.mark.parametrize(
    ("text", "without"),
    [
        ("http://anna:s3cret@cam:81/video", "http://***@cam:81/video"),
        ("rtsp://anna:p@ss@cam", "rtsp://***@cam"),
        ("http://anna:s3/cr'et@cam", "http://***@cam"),
        ('"source": "http://anna:s3cret@cam"', '"source": "http://***@cam"'),
        ("http://cam/video?size=2&access_token=abc.def&x=1", "http://cam/video?size=2&access_token=***&x=1"),
        ("http://cam/video?Password=a b", "http://cam/video?Password=*** b"),
        ("write to anna@example.org about http://cam/video?keys=3", None),
        ("http://cam/video at 3@5", None),
    ],
)
def test_credentials_of_an_address_are_left_out(text: str, without: str | None) -> None:
    wanted = without if without is not None else text.replace("keys=3", "keys=***")
    assert without_credentials(text) == wanted
    assert expected("camera", text, text, "").count(wanted) == 2
