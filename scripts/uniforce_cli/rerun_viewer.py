"""The rerun viewer, for those who have the extra `rerun`."""

import importlib
import subprocess
import sys
from types import ModuleType

from uniforce_vtla.errors import ContractError, expected

LOOPBACK = "127.0.0.1"


def import_rerun(wanted_by: str, instead: str) -> ModuleType:
    """Return the package ``rerun``; ContractError: not installed, use ``instead``."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        do = f"Run `pip install '.[rerun]'`, or use {instead}."
        raise ContractError(expected(wanted_by, "the package rerun-sdk", "none", do)) from error


def open_viewer(*arguments: str) -> subprocess.Popen:
    """Start rerun's viewer as a process of its own, which outlives this one, and return it.

    It listens on loopback: rerun's own ``spawn`` listens on every interface of the machine.
    """
    command = [sys.executable, "-m", "rerun", "--bind", LOOPBACK, *arguments]
    return subprocess.Popen(command, start_new_session=True)
