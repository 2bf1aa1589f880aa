"""xela_server's JSON → counts; no I/O.

First comes ``{"message": "Welcome", …}``, then messages of ``type`` "routine" with one object per sensor number, whose
``data`` holds X, Y, Z of each taxel row by row: 48 hex words as one text, or as a list.  ``calibrated`` is there or
null and not used: newtons are read from latents.  Source: XELA uSPa manual, 2023, and clients published by users.
"""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

import numpy as np

from uniforce_robots.sensors.faults import ProtocolError, SimulatedSensorError, WrongSensorError
from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import expected

WORDS = TAXEL_SHAPE[0] * TAXEL_SHAPE[1]
FULL_SCALE = 65_535
_HEX = re.compile(r"\s*[0-9A-Fa-f]{1,4}\s*")
_BUS_FIELDS = ("bustype", "bus_type", "bus")


class XelaScan(NamedTuple):
    """One scan: the server's running number (None if it gives none) and (16, 3) uint16 counts."""

    number: int | None
    counts: np.ndarray


def read_message(text: str, sensor: str, name: str) -> XelaScan | None:
    """Return the scan of ``sensor`` in a server message; None for a greeting or anything else without data.

    Args:
        text: the message.
        sensor: the sensor's number, as text.
        name: how errors call it.

    Raises:
        ProtocolError: no JSON object, or words that are no counts.
        WrongSensorError: no such sensor, or not 16 taxels.
        SimulatedSensorError: the server says that its bus is simulated.
    """
    message = _parse(text, name)
    _refuse_simulation(message, name)
    if message.get("type") != "routine":
        return None
    entry = message.get(sensor)
    if not isinstance(entry, dict):
        there = sorted(key for key, value in message.items() if key.isdigit() and isinstance(value, dict))
        raise WrongSensorError(expected(name, f"sensor {sensor}", there, "Set server_sensor to one of them."))
    number = message.get("message")
    return XelaScan(number if type(number) is int else None, _counts(entry.get("data"), name))


def _parse(text: str, name: str) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(expected(name, "JSON", error, "Is this xela_server?")) from error
    if not isinstance(message, dict):
        came = type(message).__name__
        raise ProtocolError(expected(name, "a JSON object", came, "Is this xela_server?"))
    return message


def _refuse_simulation(message: dict[str, Any], name: str) -> None:
    """Raise if a bus field, at the top or one level down, says "sim": invented data looks alive."""
    nested = [value for value in message.values() if isinstance(value, dict)]
    buses = [part.get(field) for part in (message, *nested) for field in _BUS_FIELDS]
    if any(isinstance(bus, str) and bus.strip().lower() == "sim" for bus in buses):
        do = "Set bustype in xServ.ini to the real adapter and restart xela_server."
        raise SimulatedSensorError(expected(f"{name}, bustype", "a real bus", "sim", do))


def _counts(data: object, name: str) -> np.ndarray:
    words = data.split(",") if isinstance(data, str) else data
    if not isinstance(words, list):
        came = type(data).__name__
        raise ProtocolError(expected(f"{name}, data", "48 words", came, "Is the sensor running?"))
    if len(words) != WORDS:
        do = "Is it a 4×4 patch?"
        raise WrongSensorError(expected(f"{name}, data", f"{WORDS} words", len(words), do))
    return np.array([_word(word, name) for word in words], np.uint16).reshape(TAXEL_SHAPE)


def _word(word: object, name: str) -> int:
    if isinstance(word, str) and _HEX.fullmatch(word):
        return int(word, 16)
    if type(word) is int and 0 <= word <= FULL_SCALE:
        return word
    do = "Is this the raw stream?"
    raise ProtocolError(expected(f"{name}, data", f"hex words or 0 … {FULL_SCALE}", repr(word)[:40], do))
