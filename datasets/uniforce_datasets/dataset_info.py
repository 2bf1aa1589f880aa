"""``meta/info.json`` of a LeRobot dataset: whole, typed, and no path or link leads outside.

Checked before anything else is opened.
"""

import os
import re
import string
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object

PLACEHOLDERS = ("video_key", "chunk_index", "file_index")
FORMAT = re.compile(r"(0?\d)?d?")  # 03d at most: a width of a billion would fill the memory


OF_SYSTEMS = re.compile(r"\..*|Thumbs\.db|ehthumbs\.db|desktop\.ini|__MACOSX", re.IGNORECASE)


def is_foreign(name: str) -> bool:
    """Return whether a file is an operating system's, as ``.DS_Store`` and ``._file.parquet``."""
    return OF_SYSTEMS.fullmatch(name) is not None


def parquet_files(folder: Path) -> list[Path]:
    """Return the parquet files in a folder and below, in order."""
    return sorted(file for file in folder.rglob("*.parquet") if not is_foreign(file.name))


def inside(root: Path, path: Path) -> Path:
    """Return ``path`` if it lies in ``root`` once links and ".." are followed.

    Raises DatasetError: it leads outside.
    """
    if not path.resolve().is_relative_to(root.resolve()):
        do = "Copy the files into the folder (huggingface-cli: --local-dir), "
        do += "or give the folder that holds both."
        raise DatasetError(expected(str(path), f"a path inside {root}", f"{path.resolve()}", do))
    return path


def check_links(root: Path, within: Path) -> None:
    """Raise DatasetError for a link in ``root`` that leads out of ``within``; nothing is opened."""
    for folder, folders, files in os.walk(root):  # links to folders are named, not entered
        for name in (*folders, *files):
            path = Path(folder) / name
            if path.is_symlink():
                inside(within, path)


def check_template(where: str, template: object) -> str:
    """Return a path like ``videos/{video_key}/file-{file_index:03d}.mp4`` that stays inside.

    Raises DatasetError: no text, absolute, with ``..``, or with a placeholder LeRobot doesn't have.
    """
    if not isinstance(template, str):
        raise DatasetError(_strange(where, template))
    try:
        for _, field, form, conversion in string.Formatter().parse(template):
            if field is not None and (
                field not in PLACEHOLDERS or not FORMAT.fullmatch(form or "") or conversion
            ):
                raise DatasetError(_strange(where, template))
    except ValueError as error:
        raise DatasetError(_strange(where, template)) from error
    if not _stays(template):
        raise DatasetError(_strange(where, template))
    return template


def check_key(where: str, key: str) -> str:
    """Return a feature's name if it is one plain word of a path; raise DatasetError otherwise."""
    if not key or not _stays(key) or len(Path(key).parts) != 1:
        do = "Leave out slashes, backslashes and dots alone."
        raise DatasetError(expected(where, "names of features", repr(key), do))
    return key


def _stays(path: str) -> bool:
    plain = "\\" not in path and "\0" not in path
    return plain and not path.startswith(("/", "~")) and not {"..", "."} & set(path.split("/"))


def _strange(where: str, template: object) -> str:
    wanted = f"a path inside the dataset, made of {', '.join(PLACEHOLDERS)}"
    return expected(where, wanted, repr(template), "Who wrote this dataset? Don't open it.")


INFO = Path("meta") / "info.json"
TEMPLATES = ("data_path", "video_path")  # LeRobot opens both


def read_info(root: Path, within: Path | None = None) -> dict[str, Any]:
    """Return a dataset's info.

    Args:
        root: the dataset's folder.
        within: folder that its links may lead into; None is the dataset's own.

    Raises DatasetError: none there, broken, without episodes, or naming a path or holding a link
    that leads outside.
    """
    file = root / INFO
    if not file.is_file():
        raise DatasetError(
            expected(str(root), str(INFO), "none", "Give the folder that uniforce record wrote.")
        )
    check_links(root, within or root)
    info = read_object(file, DatasetError)
    _check_version(file, info)
    for name, (kind, wanted) in _NEEDED.items():
        if not isinstance(info.get(name), kind) or isinstance(info[name], bool):
            raise DatasetError(
                expected(f"{name} in {file}", wanted, _short(info.get(name)), "Restore it.")
            )
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
        raise DatasetError(
            expected(str(file.parents[1]), "episodes", "none", "Record at least one.")
        )
    if not 0 < info["fps"] < 1e6 or info["total_episodes"] < 0 or info["total_frames"] < 1:
        came = {name: _short(info[name]) for name in ("fps", "total_episodes", "total_frames")}
        raise DatasetError(expected(str(file), "numbers above 0", came, "Restore it."))


def _check_feature(file: Path, key: str, feature: object) -> None:
    match feature:
        case {"dtype": str(), "shape": list()}:
            return
    raise DatasetError(
        expected(f"{key} in {file}", "dtype and shape", _short(feature), "Restore it.")
    )


def _short(value: object) -> str:
    return repr(value)[:200]
