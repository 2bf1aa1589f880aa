"""One way to read a command line: ``key=value``, ``a.b=c`` or ``--a.b=c``, into a config dataclass."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import draccus


def to_flags(argv: Sequence[str]) -> list[str]:
    """Turn ``key=value`` into ``--key=value``; leave everything else as it came."""
    return [f"--{a}" if "=" in a and not a.startswith("-") else a for a in argv]


def parse[ConfigT](config_class: type[ConfigT], argv: Sequence[str] | None = None) -> ConfigT:
    """Parse ``argv`` (the process's own when None) into ``config_class``.

    ``--help`` prints the class's docstring (give an example there) and every field with its comment.
    """
    args = to_flags(sys.argv[1:] if argv is None else argv)
    return draccus.parse(config_class=config_class, args=args)
