"""Finding a column, topic or group by what people call it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def plain(name: str) -> str:
    """Return ``name`` in lower case, its parts joined by "_": ``/force-torque`` and ``Force.Torque`` are alike."""
    return "_".join(re.findall(r"[a-z0-9]+", name.lower()))


def matching(names: Sequence[str], words: Iterable[str]) -> list[str]:
    """Return the names meant by the first of ``words`` that finds any.

    A word finds the name that is the word; else names in which a part begins with it: "ft" finds ``ft_sensor``,
    never ``left``.
    """
    for word in words:
        exact = [name for name in names if plain(name) == plain(word)]
        named = exact or [name for name in names if f"_{plain(word)}" in f"_{plain(name)}"]
        if named:
            return named
    return []


def choose(given: str, names: Sequence[str], words: Iterable[str]) -> str | None:
    """Return the one name meant: ``given``, or else the only match of ``words``; None where that isn't clear."""
    if given:
        return given if given in names else None
    named = matching(names, words)
    return named[0] if len(named) == 1 else None
