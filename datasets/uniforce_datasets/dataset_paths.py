"""Paths a dataset names, and links it holds: none may lead out of its folder. Checked before anything is opened."""

import os
import re
import string
from pathlib import Path

from uniforce_vtla.errors import DatasetError, expected

PLACEHOLDERS = ("video_key", "chunk_index", "file_index")
FORMAT = re.compile(r"(0?\d)?d?")  # 03d at most: a width of a billion would fill the memory


def inside(root: Path, path: Path) -> Path:
    """Return ``path`` if it lies in ``root`` once links and ".." are followed.

    Raises DatasetError: it leads outside.
    """
    if not path.resolve().is_relative_to(root.resolve()):
        do = "Copy the files into the folder (huggingface-cli: --local-dir), or give the folder that holds both."
        raise DatasetError(expected(str(path), f"a path inside {root}", f"{path.resolve()}", do))
    return path


def check_links(root: Path, within: Path) -> None:
    """Raise DatasetError if a file or folder in ``root`` is a link that leads out of ``within``; nothing is opened."""
    for folder, folders, files in os.walk(root):  # links to folders are named, not entered
        for name in (*folders, *files):
            path = Path(folder) / name
            if path.is_symlink():
                inside(within, path)


def check_template(where: str, template: object) -> str:
    """Return a path like ``videos/{video_key}/file-{file_index:03d}.mp4`` if whatever it becomes stays inside.

    Raises DatasetError: no text, absolute, with ``..``, or with a placeholder LeRobot doesn't have.
    """
    if not isinstance(template, str):
        raise DatasetError(_strange(where, template))
    try:
        parts = list(string.Formatter().parse(template))
    except ValueError as error:
        raise DatasetError(_strange(where, template)) from error
    known = all(
        field is None or (field in PLACEHOLDERS and FORMAT.fullmatch(form or "") and not turn)
        for _, field, form, turn in parts
    )
    if not known or not _stays(template):
        raise DatasetError(_strange(where, template))
    return template


def check_key(where: str, key: str) -> str:
    """Return a feature's name if it is one plain word of a path; raise DatasetError otherwise."""
    if not key or not _stays(key) or len(Path(key).parts) != 1:
        raise DatasetError(
            expected(where, "names of features", repr(key), "Leave out slashes, backslashes and dots alone.")
        )
    return key


def _stays(path: str) -> bool:
    plain = "\\" not in path and "\0" not in path
    return plain and not path.startswith(("/", "~")) and not {"..", "."} & set(path.split("/"))


def _strange(where: str, template: object) -> str:
    wanted = f"a path inside the dataset, made of {', '.join(PLACEHOLDERS)}"
    return expected(where, wanted, repr(template), "Who wrote this dataset? Don't open it.")
