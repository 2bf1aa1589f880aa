"""JSON files: an object, or an error of ours, read from what others wrote; written in one step."""

import json
import os
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import UniForceError, expected

# a dataset's statistics with pictures in it stay far below; more is no settings file
MAX_BYTES = 64 << 20


def read_object(path: Path, failure: type[UniForceError]) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises failure: unreadable, larger than any of ours, no JSON, nested without end, or no object.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise failure(
                expected(str(path), f"at most {MAX_BYTES} bytes", "more", "Is this the right file?")
            )
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError, OSError) as error:
        do = "It is cut or damaged: restore it from a copy."
        raise failure(expected(str(path), "JSON", repr(error)[:200], do)) from error
    if not isinstance(content, dict):
        raise failure(
            expected(str(path), "a JSON object", type(content).__name__, "Restore it from a copy.")
        )
    return content


def replace_json(path: Path, content: dict[str, Any]) -> Path:
    """Write a JSON file in one step; ValueError: NaN or infinity, which JSON doesn't know."""
    # a temporary file of Python's own could be read by nobody else
    fresh = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        fresh.write_text(json.dumps(content, indent=1, allow_nan=False))
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)  # half a file of a full disk
    return path
