"""Files and facts of a dataset or policy that may leave this machine: lists of what may, only.

A value on a list is kept as far as it is of its kind: a path, an address or a note has no way in.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.file_hashes import HASHES, hash_files, read_hashes, store_hashes
from uniforce_vtla.json_file import read_object

NOTHING = object()
type Kind = Literal["numbers", "text"] | Mapping[str, Kind]  # "*" stands for every name

CHUNK = r"chunk-\d+/file-\d+"
DATASET_FILES = re.compile(
    rf"(data|meta/episodes)/{CHUNK}\.parquet|meta/tasks\.parquet|meta/(info|stats|rig)\.json"
    rf"|{re.escape(HASHES)}|videos/[\w.-]+/{CHUNK}\.mp4"
    r"|raw/\w+/episode_\d+\.mp4|cards/episode_\d+\.json"
)
POLICY_FILES = re.compile(
    rf"README\.md|config\.json|{re.escape(HASHES)}|scores\.json|provenance\.json|model\.safetensors"
    r"|policy_(pre|post)processor(_step_\d+_\w+)?\.(json|safetensors)"
)
PROVENANCE: Mapping[str, Kind] = {
    **dict.fromkeys(("version", "machine", "date", "device", "commit"), "text"),
    "dirty": "numbers",
}
SETTINGS: Kind = {  # of uniforce record
    **dict.fromkeys(
        ("robot", "teleop", "level", "left_sensor", "right_sensor", "operator", "verdict"), "text"
    ),
    "prompts": "text",
    "episodes": "numbers",
    "seed": "numbers",
    "episode_s": "numbers",
    "window": "numbers",
    "reserve_MB": "numbers",
    "unwell_s": "numbers",
    "late_share": "numbers",
    "keep_failures": "numbers",
    "drive_between": "numbers",
    "keep_aborted": "numbers",
    "keep_raw": "numbers",
    "real_time": "numbers",
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
ARM: Kind = {"*": "numbers", "by_seed": "text", "policies": "text", "commits": "text"}
TESTS: Kind = {"*": "numbers", "arms": "text"}
SCORES: Kind = {
    "level": "text",
    "level_hash": "text",
    "arms": {"*": ARM},
    "tests": TESTS,
    **PROVENANCE,
}


def keep_listed(content: Any, kind: Kind) -> Any:
    """Return what a list allows of a content read from JSON; NOTHING where that is none of it."""
    if content is None:
        return None
    if isinstance(content, list):
        kept = [keep_listed(entry, kind) for entry in content]
        return NOTHING if NOTHING in kept else kept
    if isinstance(content, dict):
        if kind == "text":
            return NOTHING
        return _allowed_entries(content, {"*": kind} if kind == "numbers" else kind)
    match kind, content:
        case ("text", str()) | ("numbers", int() | float()):
            return content
    return NOTHING


def _allowed_entries(content: Mapping[str, Any], kinds: Mapping[str, Kind]) -> dict[str, Any]:
    kept = {}
    for name, value in content.items():
        kind = kinds.get(name, kinds.get("*"))
        found = NOTHING if kind is None else keep_listed(value, kind)
        if found is not NOTHING:
            kept[name] = found
    return kept


def _files(folder: Path) -> list[str]:
    """Return the names of all files in a folder and below, relative to it, sorted."""
    found = []
    for path in folder.rglob("*"):
        if path.is_file():
            found.append(path.relative_to(folder).as_posix())
    return sorted(found)


def stage_dataset(root: Path, staged: Path) -> list[str]:
    """Lay out a dataset's files that may be handed on in an empty folder; return their names.

    Large files become links; cards and ``info.json`` are written anew with what their lists allow,
    and so are their hashes. The dataset itself stays as it is. Raises DatasetError: a damaged JSON
    file.
    """
    names = [name for name in _files(root) if DATASET_FILES.fullmatch(name)]
    written = []
    for name in names:
        target = staged / name
        target.parent.mkdir(parents=True, exist_ok=True)
        kind = {"meta/info.json": INFO, "meta/rig.json": RIG}.get(name)
        if name.startswith("cards/"):
            kind = CARD
        if kind is not None and _write_allowed(root / name, target, kind):
            written.append(name)
        else:
            target.symlink_to((root / name).resolve())
    hashes = read_hashes(root, DatasetError)
    if hashes is not None:
        (staged / HASHES).unlink()
        entries = {name: hashes[name] for name in names if name in hashes}
        for name, entry in hash_files(staged, written).items():
            entries[name] = entries.get(name, {}) | entry
        store_hashes(staged, entries)
    return names


def _write_allowed(source: Path, target: Path, kind: Kind) -> bool:
    """Write the allowed part of a JSON file; write nothing and return False where it is whole."""
    content = read_object(source, DatasetError)
    kept = keep_listed(content, kind)
    if kept == content:
        return False
    target.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")
    return True


def refuse_others(out: Path, known: re.Pattern[str]) -> None:
    """Raise ContractError where a folder to hand on holds other files than the known ones.

    Hidden files are never sent.
    """
    others = [n for n in _files(out) if not known.fullmatch(n) and not n.startswith(".")]
    if others:
        came = ", ".join(others[:3])
        if len(others) > 3:
            came += f" and {len(others) - 3} more"
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


def _texts(content: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield (key, text) of every text in a content read from JSON."""
    match content:
        case str():
            yield key, content
        case dict():
            for name, entry in content.items():
                yield from _texts(entry, name)
        case list():
            for entry in content:
                yield from _texts(entry, key)
