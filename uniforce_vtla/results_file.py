"""Result files: every figure quoted in the docs is a JSON written by a command, with its provenance inside."""

import datetime
import importlib.metadata
import json
import math
import os
import platform
import sys
import tempfile
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from uniforce_vtla.errors import ContractError, expected, without_credentials

DISTRIBUTION = "lerobot_policy_pi05_uniforce"


def provenance() -> dict[str, Any]:
    """Return command line, package version, machine and date of this process."""
    return {
        "command": without_credentials(" ".join([_program(), *sys.argv[1:]])),
        "version": importlib.metadata.version(DISTRIBUTION),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, no accelerator used",
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def _program() -> str:
    """Return what was run: a module as ``python -m NAME``, else the file's name."""
    spec = sys.modules["__main__"].__spec__
    return f"python -m {spec.name.removesuffix('.__main__')}" if spec else Path(sys.argv[0]).name


def write_json(path: Path, content: dict[str, Any]) -> Path:
    """Write ``content`` atomically, so that a killed process never leaves half a file; NaN and infinity as null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as handle:
        json.dump(_strict(content), handle, indent=1, allow_nan=False)
    Path(handle.name).replace(path)
    return path


def _strict(content: Any) -> Any:
    """Return content that every reader of JSON takes: it knows finite numbers alone."""
    if isinstance(content, dict):
        return {key: _strict(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_strict(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def only_writer(path: Path) -> FileLock:
    """Return the held lock of a file or folder that a long run fills; releasing it lets another process write.

    Raises ContractError: another process fills it now, so both would do the same work and spoil each other's.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    held = FileLock(path.with_name(f".{path.name}.lock"))
    try:
        held.acquire(timeout=0)
    except Timeout as error:
        do = "Wait until it ends, or give another folder."
        raise ContractError(expected(f"who writes {path}", "this process alone", "another one too", do)) from error
    return held


def append_line(path: Path, content: dict[str, Any]) -> None:
    """Add a line of JSON and force it to disk: a killed run keeps all it has finished; half a last line is dropped."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab+") as handle:
        handle.seek(0)
        handle.truncate(handle.read().rfind(b"\n") + 1)
        handle.write(json.dumps(content).encode() + b"\n")
        handle.flush()
        os.fsync(handle.fileno())


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return what ``append_line`` wrote, without a last line that a kill has cut short; ValueError: no JSON."""
    text = path.read_text() if path.exists() else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
