import logging

import pytest

from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.file_hashes import HASHES, QUICK_BELOW, check_hashes, write_hashes

HEADER = "---\nlicense: apache-2.0\n---\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "config.json").write_text('{"a": 1}')
    (tmp_path / "model.safetensors").write_bytes(bytes(100))
    (tmp_path / "README.md").write_text(HEADER + "# a title")
    write_hashes(tmp_path)
    return tmp_path


def test_what_was_written_is_accepted_in_silence(folder, caplog):
    check_hashes(folder, CheckpointError)
    assert not caplog.records and (folder / HASHES).stat().st_mode & 0o777 == 0o644
    (folder / "README.md").write_text(HEADER + "# another text, for people")
    (folder / "notes.txt").write_text("no loader opens it")
    check_hashes(folder, CheckpointError)


def refuse(folder, says, verify="full"):
    with pytest.raises(CheckpointError, match=says):
        check_hashes(folder, CheckpointError, verify)


@pytest.mark.parametrize(
    "name, old, new, says",
    [
        ("config.json", "1", "2", r"config.json: SHA-256 \w{12}…, not"),
        ("config.json", "}", "} ", "config.json: 9 bytes, not 8"),
        ("README.md", "apache", "Apache", "README.md"),
        (HASHES, "config", "../config", "file names"),
        (HASHES, '"bytes"', '"size"', "bytes and sha256"),
    ],
)
def test_what_was_changed_is_named(folder, name, old, new, says):
    file = folder / name
    file.write_text(file.read_text().replace(old, new))
    refuse(folder, says)


@pytest.mark.parametrize(
    "content, says",
    [
        ("{}", r"config.json: without a hash; model.safetensors"),
        ('{"a": 1}', "bytes and sha256"),
        ('{"a": {"sha256": "0"}}', "bytes and sha256"),
        ('{"a": {"sha256": "0", "bytes": 1, "more": 1}}', "bytes and sha256"),
        ('{"a": {"sha256"', "JSON"),
        ('["a"]', "a JSON object"),
    ],
)
def test_damaged_hashes_are_named(folder, content, says):
    (folder / HASHES).write_text(content)
    refuse(folder, says)


def test_missing_and_strange_files_are_named(folder):
    (folder / "model.safetensors").rename(folder / "policy_x.json")
    refuse(folder, "model.safetensors: none; policy_x.json: without a hash")


def test_a_checkpoint_without_hashes_gets_one_line(folder, caplog):
    (folder / HASHES).unlink()
    with caplog.at_level(logging.WARNING):
        check_hashes(folder, CheckpointError)
    assert [record.levelname for record in caplog.records] == ["WARNING"] and HASHES in caplog.text


def test_quick_trusts_large_files_of_the_right_size(folder):
    weights = folder / "model.safetensors"
    weights.write_bytes(bytes(QUICK_BELOW))
    write_hashes(folder)
    with weights.open("r+b") as handle:
        handle.write(b"x")
    refuse(folder, r"model\.safetensors")
    for verify in ("quick", "off"):
        check_hashes(folder, CheckpointError, verify)
    weights.write_bytes(bytes(QUICK_BELOW - 1))
    check_hashes(folder, CheckpointError, "off")
    refuse(folder, "bytes, not", "quick")
