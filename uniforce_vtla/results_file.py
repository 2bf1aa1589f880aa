"""Result files: JSON written by a command, with its provenance inside."""

import datetime
import importlib.metadata
import json
import math
import os
import platform
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from uniforce_vtla.errors import ContractError, expected, without_credentials
from uniforce_vtla.json_file import replace_json

DISTRIBUTION = "lerobot_policy_pi05_uniforce"
PROVENANCE = "provenance.json"  # in every checkpoint
SOURCES = Path(__file__).parents[1]
RESULTS = "docs/results"
GIT_s = 10.0  # s, on a busy disk


def provenance() -> dict[str, Any]:
    """Return command line, package version, commit, machine, device and date of this process.

    ``commit`` and ``dirty`` (tracked files differ) are null where it isn't run from a checkout.
    """
    commit, dirty = _checkout()
    return {
        "command": without_credentials(" ".join([_program(), *sys.argv[1:]])),
        "version": importlib.metadata.version(DISTRIBUTION),
        "commit": commit,
        "dirty": dirty,
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "device": _device(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


@cache
def _checkout() -> tuple[str | None, bool | None]:
    """Return the commit of this package's checkout, and whether tracked files were changed.

    Results don't count: several programs fill one file in turn. It is read once, for the code
    that this process has imported.
    """
    if not (SOURCES / ".git").exists():  # a repository of somebody else's may lie further up
        return None, None
    try:
        commit = _git("rev-parse", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", f":!{RESULTS}")
    except (OSError, subprocess.SubprocessError):  # no git, or a folder that git distrusts
        return None, None
    return commit, bool(changed)


def _git(*words: str) -> str:
    call = ["git", "-C", str(SOURCES), *words]
    return subprocess.check_output(
        call, stderr=subprocess.DEVNULL, text=True, timeout=GIT_s
    ).strip()


def _device() -> str:
    """Return where torch computed: the accelerator that this process opened, else the CPU."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_initialized():
        return str(torch.cuda.get_device_name())
    return "cpu"


def _program() -> str:
    """Return what was run: a module as ``python -m NAME``, else the file's name."""
    spec = sys.modules["__main__"].__spec__
    if spec is None:
        return Path(sys.argv[0]).name
    return f"python -m {spec.name.removesuffix('.__main__')}"


def write_json(path: Path, content: dict[str, Any]) -> Path:
    """Write ``content`` atomically; NaN and infinity become null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return replace_json(path, _strict(content))


def _strict(content: Any) -> Any:
    """Return content that every reader of JSON takes: it knows finite numbers alone."""
    if isinstance(content, dict):
        return {key: _strict(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_strict(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


def only_writer(path: Path) -> FileLock:
    """Return the held lock of a file or folder that a long run fills; release it when done.

    Raises ContractError: another process fills it now.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    held = FileLock(path.with_name(f".{path.name}.lock"))
    try:
        held.acquire(timeout=0)
    except Timeout as error:
        do = "Wait until it ends, or give another folder."
        raise ContractError(
            expected(f"who writes {path}", "this process alone", "another one too", do)
        ) from error
    return held


def append_line(path: Path, content: dict[str, Any]) -> None:
    """Add a line of JSON and force it to disk; half a last line of a killed run is dropped."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab+") as handle:
        handle.seek(0)
        handle.truncate(handle.read().rfind(b"\n") + 1)
        handle.write(json.dumps(content).encode() + b"\n")
        handle.flush()
        os.fsync(handle.fileno())


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return what ``append_line`` wrote, without half a last line; ValueError: no JSON."""
    if not path.exists():
        return []
    text = path.read_text()
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
