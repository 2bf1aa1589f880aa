"""One way to read a command line: ``key=value``, ``a.b=c`` or ``--a.b=c``, into a config dataclass."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import draccus
import numpy as np

from uniforce_vtla.errors import ContractError, expected


def to_flags(argv: Sequence[str]) -> list[str]:
    """Turn ``key=value`` into ``--key=value``; leave everything else as it came."""
    return [f"--{a}" if "=" in a and not a.startswith("-") else a for a in argv]


def parse[ConfigT](
    config_class: type[ConfigT], argv: Sequence[str] | None = None, presets: Path | None = None
) -> ConfigT:
    """Parse ``argv`` (the process's own when None) into ``config_class``.

    ``--help`` prints the class's docstring (give an example there) and every field with its comment.  Where a
    command has ``presets``, ``preset=NAME`` reads ``NAME.yaml`` there first; what else is given overrides it.

    Raises:
        ContractError: no such preset.
    """
    args = to_flags(sys.argv[1:] if argv is None else argv)
    config_path = None if presets is None else _preset_path(args, presets)
    return draccus.parse(config_class=config_class, config_path=config_path, args=args)


def names_in(text: str) -> list[str]:
    """Return the names in a text with commas between them."""
    return [name.strip() for name in text.split(",") if name.strip()]


def choose[T](known: dict[str, T], only: str) -> dict[str, T]:
    """Return the entries named in ``only`` (comma between them); all of them when empty.

    Raises:
        ContractError: a name nobody knows.
    """
    names = names_in(only) or list(known)
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise ContractError(expected("only", " | ".join(known), unknown, "Name rows of the table."))
    return {name: known[name] for name in names}


def numbers(name: str, text: str, count: int) -> np.ndarray:
    """Return (count,) float64 from a setting like ``0.6,0.7``.

    Raises:
        ContractError: anything but so many numbers.
    """
    parts = [part for part in text.split(",") if part.strip()]
    try:
        values = np.array([float(part) for part in parts])
    except ValueError as error:
        raise ContractError(expected(name, f"{count} numbers", repr(text), "Commas between them.")) from error
    if len(values) != count:
        raise ContractError(expected(name, f"{count} numbers", repr(text), "Commas between them."))
    return values


def _preset_path(args: Sequence[str], presets: Path) -> Path | None:
    names = [a.removeprefix("--preset=") for a in args if a.startswith("--preset=") and a != "--preset="]
    if not names:
        return None
    known = sorted(p.stem for p in presets.glob("*.yaml"))
    path = presets / f"{names[-1]}.yaml"
    if names[-1] not in known:  # nor does a name with slashes lead out of the folder
        raise ContractError(expected("preset", " | ".join(known), names[-1], "Name one, or give none."))
    return path
