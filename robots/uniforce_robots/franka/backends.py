"""Load exactly one vendor's client: the two register the same C++ types and fail in one process, in either order."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

from uniforce_vtla.errors import RobotError, expected

EXTRAS = {"franky": "franka", "pylibfranka": "franka-official"}
DISTRIBUTION = "lerobot_policy_pi05_uniforce"


def load_client(name: str) -> ModuleType:
    """Import ``franky`` or ``pylibfranka``.

    Raises:
        RobotError: not installed, or the other one is already loaded in this process.
    """
    others = [other for other in EXTRAS if other != name and other in sys.modules]
    if others:
        do = "Start a new process, and choose one backend in it."
        raise RobotError(
            expected("Franka client", f"{name} alone", f"{others[0]} loaded already", do), "backend"
        )
    try:
        return importlib.import_module(name)
    except ImportError as error:
        do = f'Install it: pip install "{DISTRIBUTION}[{EXTRAS[name]}]" (Linux x86_64 only).'
        raise RobotError(expected("Franka client", f"{name} installed", error, do), "backend") from error


def fault_of(text: str) -> str:
    """Return the ``RobotError.fault`` a client's message means; the clients share libfranka's wording."""
    lowered = text.lower()
    words = {
        "incompatible": "version",
        "infinite or nan": "bad_state",
        "user stop": "user_stop",
        "reflex": "reflex",
        "timeout": "connection",
        "connection": "connection",
        "network": "connection",
        "tcp": "connection",
        "udp": "connection",
    }
    return next((fault for word, fault in words.items() if word in lowered), "other")
