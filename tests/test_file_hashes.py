import json
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


def rewritten(name, change):
    return lambda folder: (folder / name).write_text(change((folder / name).read_text()))


def test_what_was_written_is_accepted_in_silence(folder, caplog):
    check_hashes(folder, CheckpointError)
    assert not caplog.records and (folder / HASHES).stat().st_mode & 0o777 == 0o644
    (folder / "README.md").write_text(HEADER + "# another text, for people")
    (folder / "notes.txt").write_text("no loader opens it")
    check_hashes(folder, CheckpointError)


@pytest.mark.parametrize(
    "damage, says",
    [
        (
            rewritten("config.json", lambda text: text.replace("1", "2")),
            r"config.json: SHA-256 \w{12}…, not",
        ),
        (rewritten("config.json", lambda text: text + " "), "config.json: 9 bytes, not 8"),
        (rewritten("README.md", lambda text: text.replace("apache", "Apache")), "README.md"),
        (lambda folder: (folder / "model.safetensors").unlink(), "model.safetensors: none"),
        (
            lambda folder: (folder / "policy_x.json").write_text("{}"),
            "policy_x.json: without a hash",
        ),
        (rewritten(HASHES, lambda _: "{}"), r"config.json: without a hash; model.safetensors"),
        (rewritten(HASHES, lambda text: text[:-9]), "JSON"),
        (rewritten(HASHES, lambda text: text.replace("config", "../config")), "file names"),
        (rewritten(HASHES, lambda text: text.replace('"bytes"', '"size"')), "bytes and sha256"),
        (rewritten(HASHES, lambda _: '{"a": 1}'), "bytes and sha256"),
        (rewritten(HASHES, lambda _: '{"a": {"sha256": "0"}}'), "bytes and sha256"),
        (
            rewritten(HASHES, lambda _: '{"a": {"sha256": "0", "bytes": 1, "more": 1}}'),
            "bytes and sha256",
        ),
        (rewritten(HASHES, lambda _: "\0"), "JSON"),
        (rewritten(HASHES, lambda text: json.dumps([text])), "a JSON object"),
    ],
)
def test_what_was_changed_is_named(folder, damage, says):
    damage(folder)
    with pytest.raises(CheckpointError, match=says):
        check_hashes(folder, CheckpointError)


def test_a_checkpoint_without_hashes_gets_one_line(folder, caplog):
    (folder / HASHES).unlink()
    with caplog.at_level(logging.WARNING):
        check_hashes(folder, CheckpointError)
    assert [record.levelname for record in caplog.records] == ["WARNING"] and HASHES in caplog.text


@pytest.mark.parametrize("verify, refused", [("full", True), ("quick", False), ("off", False)])
def test_quick_trusts_large_files_of_the_right_size(folder, verify, refused):
    weights = folder / "model.safetensors"
    weights.write_bytes(bytes(QUICK_BELOW))
    write_hashes(folder)
    with weights.open("r+b") as handle:
        handle.write(b"x")
    if refused:
        with pytest.raises(CheckpointError, match=r"model\.safetensors"):
            check_hashes(folder, CheckpointError, verify)
        return
    check_hashes(folder, CheckpointError, verify)
    weights.write_bytes(bytes(QUICK_BELOW - 1))
    if verify == "quick":
        with pytest.raises(CheckpointError, match="bytes, not"):
            check_hashes(folder, CheckpointError, verify)
