"""Kinds of damage to a checkpoint; none yet."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol


class CheckpointDamage(Protocol):
    """One kind: what it is called, and what loading says of a damaged copy."""

    name: str

    def refused(self, folder: Path) -> str | None:
        """Return the error's line; None where the copy was accepted."""


CHECKPOINT_DAMAGES: tuple[CheckpointDamage, ...] = ()
