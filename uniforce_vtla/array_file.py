"""Read numpy's own files: numbers only, no pickles, and no more than the file holds."""

import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uniforce_vtla.errors import DatasetError, expected

DAMAGE = (  # raised by numpy and zipfile over damaged files
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    OSError,
    OverflowError,
    MemoryError,
    RecursionError,
    SyntaxError,
    NotImplementedError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_array(path: Path, mapped: bool = False) -> np.ndarray:
    """Return the array in a .npy file.

    It is mapped first, so that a header that announces more than the file holds costs nothing.

    Args:
        path: of the file.
        mapped: leave it on disk, read only.

    Raises DatasetError: truncated, pickled, empty, or no single array.
    """
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(array, np.ndarray):
            if mapped:
                return array
            return np.array(array)
    except DAMAGE as error:
        raise DatasetError(_broken(path, "a whole .npy array", error)) from error
    array.close()
    raise DatasetError(_broken(path, "one array, saved with numpy.save", "an archive"))


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return arrays of a .npz file by name.

    Raises DatasetError: truncated, pickled, compressed (ours never are), or one is missing.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if entry.compress_type != zipfile.ZIP_STORED:
                    wanted = "arrays as numpy.savez stores them"
                    raise DatasetError(_broken(path, wanted, "compressed ones"))
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in names}
    except DAMAGE as error:
        raise DatasetError(_broken(path, f"arrays {', '.join(names)}", error)) from error


def _broken(path: Path, wanted: str, came: object) -> str:
    return expected(str(path), wanted, came, "Restore it from a copy.")
