"""Settings of the rig that recorded a dataset, ``meta/rig.json``: later sessions are compared.

Each entry says from which episode on its settings held. Nothing in it names a person, a machine or
a network: where a device is, is stored as a short hash, so that two that were exchanged still
differ.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.json_file import read_object

RIG = Path("meta") / "rig.json"
Settings = dict[str, Any]  # JSON values by dotted name
PRIVATE = re.compile(r"id|address|calibration_dir|\w*(user|password|token|secret)\w*")
PLACE = re.compile(r"source|device|\w*(port|path|host|url|serial|address)\w*")
LEADS_SOMEWHERE = re.compile(r"[/\\@:~]")
LOGIN = re.compile(r"(?<=://)[^@]*@")


def plain_settings(prefix: str, nested: Mapping[str, Any]) -> Settings:
    """Return nested settings by dotted name below ``prefix``, as they may be stored."""
    found: Settings = {}
    for name, value in nested.items():
        if isinstance(value, Mapping):
            found |= plain_settings(f"{prefix}.{name}", value)
        elif not PRIVATE.fullmatch(name):
            found[f"{prefix}.{name}"] = _plain(name, value)
    return found


def _plain(name: str, value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(name, part) for part in value]
    if not isinstance(value, str):
        return value if isinstance(value, int | float | None) else _plain(name, str(value))
    if value and (PLACE.fullmatch(name) or LEADS_SOMEWHERE.search(value)):
        return "#" + hashlib.sha256(LOGIN.sub("", value).encode()).hexdigest()[:8]
    return value


def stored_settings(root: Path) -> list[dict[str, Any]]:
    """Return ``from_episode`` and ``settings`` of each stretch of a dataset that knows any.

    Raises DatasetError: the file is damaged.
    """
    if not (root / RIG).is_file():
        return []
    match read_object(root / RIG, DatasetError):
        case {"stretches": list() as stretches} if all(map(_is_stretch, stretches)):
            return stretches
    raise DatasetError(
        expected(str(root / RIG), "settings of a rig", "something else", "Restore it from a copy.")
    )


def _is_stretch(entry: object) -> bool:
    return isinstance(entry, dict) and isinstance(entry.get("settings"), dict)


def _last_settings(root: Path) -> Settings:
    stretches = stored_settings(root)
    return stretches[-1]["settings"] if stretches else {}


def agreed_changes(root: Path, settings: Settings, accept: bool) -> dict[str, tuple[Any, Any]]:
    """Return by name each setting that differs from the dataset's last ones, before and now.

    A setting that only one version of the program knows is no difference. Raises ContractError:
    there is one, and not ``accept``.
    """
    before = _last_settings(root)
    changes = {}
    for name in sorted(before.keys() & settings.keys()):
        if before[name] != settings[name]:
            changes[name] = (before[name], settings[name])
    if changes and not accept:
        came = ", ".join(f"{name} {old!r} → {new!r}" for name, (old, new) in changes.items())
        do = "Put them back, record into another root, or go on with settings_changed=accept."
        raise ContractError(
            expected("settings", "those that this dataset was recorded with", came, do)
        )
    return changes


def write_settings(root: Path, staged: Path, episode: int, settings: Settings) -> None:
    """Stage the settings from ``episode`` on; nothing where they are the last ones still."""
    if settings and settings != _last_settings(root):
        stretches = [*stored_settings(root), {"from_episode": episode, "settings": settings}]
        content = {"stretches": stretches}
        (staged / RIG).write_text(json.dumps(content, indent=1) + "\n")
