"""UniForce: a latent force space shared by tactile sensors of any kind.

The names below are looked up when they are first used: a driver or an error needs no torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uniforce_vtla.force_sensor import ForceReading, ForceSensor
    from uniforce_vtla.markers import Canonicalizer, to_finger_frame
    from uniforce_vtla.sensors import list_sensors
    from uniforce_vtla.tokenizer import ForceHead, Latent, Tokenizer

__all__ = [
    "Canonicalizer",
    "ForceHead",
    "ForceReading",
    "ForceSensor",
    "Latent",
    "Tokenizer",
    "list_sensors",
    "to_finger_frame",
]

_HOME = {
    "ForceReading": "force_sensor",
    "ForceSensor": "force_sensor",
    "Canonicalizer": "markers",
    "to_finger_frame": "markers",
    "list_sensors": "sensors",
    "ForceHead": "tokenizer",
    "Latent": "tokenizer",
    "Tokenizer": "tokenizer",
}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
