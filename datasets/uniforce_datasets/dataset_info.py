"""``meta/info.json`` of a LeRobot dataset: whole, of the right types, and naming no path outside."""

import math
from pathlib import Path
from typing import Any

from uniforce_datasets.dataset_paths import check_key, check_links, check_template
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object

INFO = Path("meta") / "info.json"
TEMPLATES = ("data_path", "video_path")  # LeRobot opens both


def read_info(root: Path, within: Path | None = None) -> dict[str, Any]:
    """Return a dataset's info.

    Args:
        root: the dataset's folder.
        within: folder that its links may lead into; None is the dataset's own.

    Raises DatasetError: none there, broken, without episodes, or naming a path or holding a link that leads outside.
    """
    file = root / INFO
    if not file.is_file():
        raise DatasetError(expected(str(root), str(INFO), "none", "Give the folder that uniforce record wrote."))
    check_links(root, within or root)
    info = read_object(file, DatasetError)
    _check_version(file, info)
    for name, (kind, wanted) in _NEEDED.items():
        if not isinstance(info.get(name), kind) or isinstance(info[name], bool):
            raise DatasetError(expected(f"{name} in {file}", wanted, _short(info.get(name)), "Restore it."))
    _check_numbers(file, info)
    for key, feature in info["features"].items():
        check_key(str(file), key)
        _check_feature(file, key, feature)
    for name in TEMPLATES:
        if info.get(name) is not None:
            check_template(f"{name} in {file}", info[name])
    if videos(info) and not info.get("video_path"):
        raise DatasetError(expected(str(file), "video_path", "none", "Restore it."))
    return info


def videos(info: dict[str, Any]) -> list[str]:
    """Return the keys of a dataset's videos."""
    return [key for key, feature in info["features"].items() if feature["dtype"] == "video"]


_NEEDED: dict[str, tuple[type | tuple[type, ...], str]] = {
    "features": (dict, "features by name"),
    "fps": ((int, float), "frames per second"),
    "total_episodes": (int, "a count"),
    "total_frames": (int, "a count"),
}


def _check_version(file: Path, info: dict[str, Any]) -> None:
    version = str(info.get("codebase_version"))[:20]
    if not version.startswith("v3"):
        do = "Convert it with LeRobot's own converter (lerobot.scripts.convert_dataset_v21_to_v30)."
        raise DatasetError(expected(f"codebase_version in {file}", "LeRobot v3", version, do))


def _check_numbers(file: Path, info: dict[str, Any]) -> None:
    if not info["total_episodes"]:
        raise DatasetError(expected(str(file.parents[1]), "episodes", "none", "Record at least one."))
    fps = float(info["fps"]) if abs(info["fps"]) < 1e6 else math.inf
    if not (0 < fps < math.inf) or info["total_episodes"] < 0 or info["total_frames"] < 1:
        came = {name: _short(info[name]) for name in ("fps", "total_episodes", "total_frames")}
        raise DatasetError(expected(str(file), "numbers above 0", came, "Restore it."))


def _check_feature(file: Path, key: str, feature: object) -> None:
    whole = isinstance(feature, dict) and isinstance(feature.get("dtype"), str)
    if not whole or not isinstance(feature.get("shape"), list):  # type: ignore[attr-defined]
        raise DatasetError(expected(f"{key} in {file}", "dtype and shape", _short(feature), "Restore it."))


def _short(value: object) -> str:
    return repr(value)[:200]
