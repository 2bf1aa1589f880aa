"""What a benchmark's table says of one of its checkpoints: the arms that ran it, on the scenes that were its turn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.plan import ARMS

CLEAN, EVENTFUL = "C", "s"  # letters of EpisodeRow.code: wiped clean, wiped with an event


def scores_of(table: Mapping[str, Any], checkpoint: str) -> dict[str, Any]:
    """Return the part of a benchmark's table that belongs on a checkpoint's card.

    Args:
        table: what ``uniforce-benchmark`` wrote (``wiping.json``).
        checkpoint: as it was scored: a folder of ``table["checkpoints"]`` and its own name, ``…/seed0/vt``.

    Raises:
        ContractError: a checkpoint that isn't in the table.
    """
    seeds = list(table.get("checkpoints", ()))
    folder = PurePath(checkpoint)
    arms = [arm.name for arm in ARMS if arm.checkpoint == folder.name and arm.name in table["arms"]]
    if str(folder.parent) not in seeds or not arms:
        do = "Name it as it was scored."
        raise ContractError(expected("checkpoint", f"a checkpoint inside {seeds}", checkpoint, do))
    turn = seeds.index(str(folder.parent))
    own = {name: _turns(table["arms"][name]["by_seed"], turn, len(seeds)) for name in arms}
    return dict(table) | {"checkpoints": [checkpoint], "arms": own, "tests": [], "as_good": []}


def _turns(by_seed: str, turn: int, of: int) -> dict[str, Any]:
    letters = by_seed[turn::of]  # as ``whose_turn`` deals scenes out
    clean = letters.count(CLEAN)
    return {"n": len(letters), "clean": clean, "success": clean + letters.count(EVENTFUL), "by_seed": letters}
