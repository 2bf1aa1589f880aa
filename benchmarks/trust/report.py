"""One result file that several attacks fill, each its own key."""

import json
from pathlib import Path
from typing import Any

from uniforce_vtla.results_file import provenance, write_json


def update(path: Path, key: str, content: dict[str, Any]) -> Path:
    """Replace one key of a result file, and under ``made_by`` the command that made it; the others stay.

    Raises:
        ValueError: the file is no JSON object.
    """
    whole = json.loads(path.read_text()) if path.is_file() else {}
    origin = whole.get("made_by", {}) | {key: provenance()}
    return write_json(path, whole | {key: content, "made_by": origin})
