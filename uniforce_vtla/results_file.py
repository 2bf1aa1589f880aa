"""Result files: every figure quoted in the docs is a JSON written by a command, with its provenance inside."""

import datetime
import importlib.metadata
import json
import os
import platform
import sys
import tempfile
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import without_credentials

DISTRIBUTION = "lerobot_policy_pi05_uniforce"


def provenance() -> dict[str, Any]:
    """Return command line, package version, machine and date of this process."""
    return {
        "command": without_credentials(" ".join([Path(sys.argv[0]).name, *sys.argv[1:]])),
        "version": importlib.metadata.version(DISTRIBUTION),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, no accelerator used",
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def write_json(path: Path, content: dict[str, Any]) -> Path:
    """Write ``content`` atomically, so that a killed process never leaves half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as handle:
        json.dump(content, handle, indent=1)
    Path(handle.name).replace(path)
    return path
