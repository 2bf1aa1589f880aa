"""The settings of the rig that recorded a dataset, ``meta/rig.json``: a later session with others is noticed.

Each entry says from which episode on its settings held. Nothing in it names a person, a machine or a network: where a
device is, is stored as a short hash, so that two that were exchanged still differ.
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
    """Return what a dataset knows: ``from_episode`` and ``settings`` of each stretch; empty where it knows none.

    Raises DatasetError: the file is damaged.
    """
    if not (root / RIG).is_file():
        return []
    stretches = read_object(root / RIG, DatasetError).get("stretches")
    entries: list[Any] = stretches if isinstance(stretches, list) else [None]
    if all(
        isinstance(entry, dict) and isinstance(entry.get("settings"), dict) for entry in entries
    ):
        return entries
    raise DatasetError(
        expected(str(root / RIG), "settings of a rig", "something else", "Restore it from a copy.")
    )


def agreed_changes(root: Path, settings: Settings, accept: bool) -> dict[str, tuple[Any, Any]]:
    """Return by name each setting that differs from the dataset's last ones, before and now.

    What only one version of the program knows is no difference. Raises ContractError: there is one, and not ``accept``.
    """
    last = [stretch["settings"] for stretch in stored_settings(root)][-1:]
    changes = {
        name: (before[name], settings[name])
        for before in last
        for name in sorted(before.keys() & settings.keys())
        if before[name] != settings[name]
    }
    if changes and not accept:
        came = ", ".join(f"{name} {before!r} → {now!r}" for name, (before, now) in changes.items())
        do = "Put them back, record into another root, or go on with settings_changed=accept."
        raise ContractError(
            expected("settings", "those that this dataset was recorded with", came, do)
        )
    return changes


def write_settings(root: Path, staged: Path, episode: int, settings: Settings) -> None:
    """Stage the settings from ``episode`` on; nothing where they are the last ones still."""
    stretches = stored_settings(root)
    if settings and [stretch["settings"] for stretch in stretches[-1:]] != [settings]:
        content = {"stretches": [*stretches, {"from_episode": episode, "settings": settings}]}
        (staged / RIG).write_text(json.dumps(content, indent=1) + "\n")
