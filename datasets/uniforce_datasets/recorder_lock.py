"""One recorder per dataset: a file lock that ends with the process that holds it, however that ends."""

from __future__ import annotations

import tempfile
from pathlib import Path

from filelock import FileLock, Timeout

from uniforce_datasets.staging import COMMIT
from uniforce_vtla.errors import DatasetError, expected


def claim(root: str | Path) -> Path:
    """Return the folder of a dataset, made where there is none. Nothing is left in a folder that is refused.

    Raises:
        DatasetError: no name, nothing can be written there, or it holds something else.
    """
    do = "Give root=… a folder you may write to."
    if not str(root).strip():
        raise DatasetError(expected("root", "a folder", repr(str(root)), do))
    folder = Path(root)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            foreign = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise DatasetError(expected(f"root={root}", "a folder to write to", error, do)) from error
    if foreign and not any((folder / name).exists() for name in (COMMIT, "meta/info.json")):
        do = "Choose another root."
        raise DatasetError(expected(str(folder), "an empty folder or a dataset", foreign[:3], do))
    return folder


def lock(root: Path, wait_s: float) -> FileLock:
    """Return the held lock of a dataset's folder; releasing it lets others record.

    Args:
        root: the folder.
        wait_s: how long to wait for another recorder that is about to end.

    Raises:
        DatasetError: another recorder holds it.
    """
    held = FileLock(root / ".recorder.lock")
    try:
        held.acquire(timeout=wait_s)
    except Timeout as error:
        do = "Wait, or use another root."
        raise DatasetError(expected(str(root), "one recorder at a time", "another one", do)) from error
    return held
