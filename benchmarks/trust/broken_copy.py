"""Break one place of a copy of the robot's packages, and see whether an attack on it notices."""

import importlib
import importlib.util
import logging
import multiprocessing
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from tqdm import tqdm

from uniforce_vtla.errors import ContractError, expected

PACKAGES = ("uniforce_robots", "uniforce_vtla")
Mutation = tuple[str, str, str]  # file, the text that stands there, the text in its place


@contextmanager
def broken(name: str, mutation: Mutation) -> Iterator[None]:
    """Have the packages imported from a copy with this mutation; needs a fresh process."""
    file, old, new = mutation
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        for package in PACKAGES:
            source = importlib.util.find_spec(package)
            shutil.copytree(Path(str(source and source.origin)).parent, Path(folder) / package)
        copy = Path(folder) / file
        text = copy.read_text()
        if text.count(old) != 1:
            raise ContractError(
                expected(name, f"{old!r} once in {file}", text.count(old), "Mend the table.")
            )
        copy.write_text(text.replace(old, new))
        sys.path.insert(0, folder)  # the copies are found before the packages themselves
        for loaded in list(sys.modules):
            if loaded.partition(".")[0] in (*PACKAGES, "benchmarks"):
                del sys.modules[loaded]
        for package in PACKAGES:
            tried = str(importlib.import_module(package).__file__)
            if not tried.startswith(folder):
                raise ContractError(expected(name, f"{package} in {folder}", tried, "Preloaded?"))
        yield


def try_all(notice: Callable[[str], str], names: Sequence[str]) -> dict[str, str]:
    """Return what was noticed of each mutation, "" of survivors; a process for each."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context, max_tasks_per_child=1) as pool:
        found = tqdm(pool.map(notice, names), total=len(names), desc="mutations")
        table = dict(zip(names, found, strict=True))
    survivors = [name for name, seen in table.items() if not seen]
    noticed = len(table) - len(survivors)
    print(f"{noticed} of {len(table)} noticed; survivors: {survivors or 'none'}")
    return table
