"""Which files and facts of a dataset or policy may leave this machine: lists of what may, never of what may not.

A value on a list is kept as far as it is of its kind: a path, an address or a note has no way in.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.file_hashes import HASHES, hash_files, read_hashes, store_hashes
from uniforce_vtla.json_file import read_object

NOTHING = object()
type Kind = Literal["numbers", "text"] | Mapping[str, Kind]  # "*" stands for every name

CHUNK = r"chunk-\d+/file-\d+"
DATASET_FILES = re.compile(
    rf"(data|meta/episodes)/{CHUNK}\.parquet|meta/tasks\.parquet|meta/(info|stats|rig)\.json|{re.escape(HASHES)}|"
    rf"videos/[\w.-]+/{CHUNK}\.mp4|raw/\w+/episode_\d+\.mp4|cards/episode_\d+\.json"
)
POLICY_FILES = re.compile(
    rf"README\.md|config\.json|{re.escape(HASHES)}|scores\.json|provenance\.json|model\.safetensors|"
    r"policy_(pre|post)processor(_step_\d+_\w+)?\.(json|safetensors)"
)
PROVENANCE: Mapping[str, Kind] = {
    **dict.fromkeys(("version", "machine", "date", "device", "commit"), "text"),
    "dirty": "numbers",
}
SETTINGS: Kind = {  # of uniforce record
    **dict.fromkeys(
        ("robot", "teleop", "level", "left_sensor", "right_sensor", "operator", "verdict"), "text"
    ),
    **dict.fromkeys(
        ("episodes", "seed", "episode_s", "window", "reserve_MB", "unwell_s", "late_share"),
        "numbers",
    ),
    **dict.fromkeys(
        ("keep_failures", "drive_between", "keep_aborted", "keep_raw", "real_time"), "numbers"
    ),
    "prompts": "text",
}
CARD: Kind = {  # of an episode
    **dict.fromkeys(("label", "prompt", "teleop", "rig", "level", "begun"), "text"),
    **dict.fromkeys(
        ("episode", "pauses", "held_s", "peak_force_N", "ticks", "guards", "sensors"), "numbers"
    ),
    "settings": SETTINGS,
}
RIG: Kind = {"stretches": "numbers"}  # settings of the rig; their texts name devices
FEATURE: Kind = {
    "dtype": "text",
    "shape": "numbers",
    "names": "text",
    "fps": "numbers",
    "info": {
        "*": "numbers",
        **dict.fromkeys(
            ("video.codec", "video.pix_fmt", "video.preset", "video.video_backend"), "text"
        ),
    },
}
INFO: Kind = {  # LeRobot's meta/info.json
    **dict.fromkeys(("codebase_version", "robot_type", "data_path", "video_path"), "text"),
    **dict.fromkeys(
        ("fps", "total_episodes", "total_frames", "total_tasks", "total_videos", "total_chunks"),
        "numbers",
    ),
    **dict.fromkeys(("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb"), "numbers"),
    "splits": {"*": "text"},
    "features": {"*": FEATURE},
}
ARM: Kind = {"*": "numbers", "by_seed": "text", "policies": "text"}
TESTS: Kind = {"*": "numbers", "arms": "text"}
SCORES: Kind = {
    "level": "text",
    "level_hash": "text",
    "arms": {"*": ARM},
    "tests": TESTS,
    **PROVENANCE,
}


def allowed(content: Any, kind: Kind) -> Any:
    """Return what a list allows of a content read from JSON; NOTHING where that is none of it."""
    if content is None:
        return None
    if isinstance(content, list):
        kept = [allowed(entry, kind) for entry in content]
        return NOTHING if NOTHING in kept else kept
    if isinstance(content, dict):
        return (
            NOTHING
            if kind == "text"
            else _allowed_entries(content, {"*": kind} if kind == "numbers" else kind)
        )
    wanted = str if kind == "text" else int | float
    return content if isinstance(kind, str) and isinstance(content, wanted) else NOTHING


def _allowed_entries(content: Mapping[str, Any], kinds: Mapping[str, Kind]) -> dict[str, Any]:
    known = {name: kinds.get(name, kinds.get("*")) for name in content}
    kept = {
        name: allowed(value, kind)
        for name, value in content.items()
        if (kind := known[name]) is not None
    }
    return {name: value for name, value in kept.items() if value is not NOTHING}


def dataset_files(root: Path) -> list[str]:
    """Return the names, relative to its folder, of those files of a dataset that may be handed on, sorted."""
    names = [path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()]
    return sorted(name for name in names if DATASET_FILES.fullmatch(name))


def stage_dataset(root: Path, staged: Path) -> list[str]:
    """Lay out in an empty folder what of a dataset may be handed on; return the files' names.

    Large files become links; cards and ``info.json`` are written anew with what their lists allow, and so are their
    hashes. The dataset itself stays as it is. Raises DatasetError: a damaged JSON file.
    """
    names = dataset_files(root)
    for name in names:
        target = staged / name
        target.parent.mkdir(parents=True, exist_ok=True)
        kind = (
            CARD
            if name.startswith("cards/")
            else {"meta/info.json": INFO, "meta/rig.json": RIG}.get(name)
        )
        if kind is None or not _write_allowed(root / name, target, kind):
            target.symlink_to((root / name).resolve())
    if (hashes := read_hashes(root, DatasetError)) is None:
        return names
    (staged / HASHES).unlink()
    written = [
        name for name in names if (staged / name).is_file() and not (staged / name).is_symlink()
    ]
    fresh = {
        name: hashes.get(name, {}) | entry for name, entry in hash_files(staged, written).items()
    }
    store_hashes(staged, {name: entry for name, entry in (hashes | fresh).items() if name in names})
    return names


def _write_allowed(source: Path, target: Path, kind: Kind) -> bool:
    """Write what a list allows of a JSON file; return False, and write nothing, where that is all of it."""
    content = read_object(source, DatasetError)
    kept = allowed(content, kind)
    if kept != content:
        target.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")
    return bool(kept != content)


def refuse_others(out: Path, known: re.Pattern[str]) -> None:
    """Raise ContractError where a folder to hand on holds files that aren't of it; hidden ones are never sent."""
    found = [path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()]
    others = sorted(
        name for name in found if not known.fullmatch(name) and not name.startswith(".")
    )
    if others:
        came = ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")
        do = "Name a new folder: everything in it is handed on."
        raise ContractError(expected("out", "a folder with nothing else in it", came, do))


def refuse_paths(folder: Path) -> None:
    """Raise ContractError where a JSON file of a policy names a path of this machine."""
    for file in sorted(folder.glob("*.json")):
        for key, text in _texts(json.loads(file.read_text())):
            if text.startswith(("/", "~")) or str(Path.home()) in text:
                do = "It leads nowhere on another machine: take it out of the checkpoint's file."
                raise ContractError(
                    expected(f"{key} in {file.name}", "no path of this machine", text, do)
                )


def _texts(content: Any, key: str = "") -> list[tuple[str, str]]:
    """Return (key, text) of every text in a content read from JSON."""
    if isinstance(content, str):
        return [(key, content)]
    entries: list[tuple[str, Any]] = []
    if isinstance(content, dict):
        entries = list(content.items())
    elif isinstance(content, list):
        entries = [(key, entry) for entry in content]
    return [found for name, entry in entries for found in _texts(entry, name)]
