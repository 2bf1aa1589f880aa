"""Checkpoints of several training seeds take turns: whose scene is whose, and what a table says of one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.arms import CLEAN, EVENTFUL
from uniforce_vtla.evaluation.plan import ARMS


def whose_turn(scene: int, names: Sequence[str]) -> str:
    """Return whose turn a scene is, counted from the first one scored."""
    return names[scene % len(names)]


def own_scenes(by_seed: str, name: str, names: Sequence[str]) -> dict[str, Any]:
    """Return an arm's counts on the scenes that were one checkpoint's turn, from the letters of all of them."""
    letters = "".join(letter for scene, letter in enumerate(by_seed) if whose_turn(scene, names) == name)
    clean = letters.count(CLEAN)
    return {"n": len(letters), "clean": clean, "success": clean + letters.count(EVENTFUL), "by_seed": letters}


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
    own = {name: own_scenes(table["arms"][name]["by_seed"], str(folder.parent), seeds) for name in arms}
    return dict(table) | {"checkpoints": [checkpoint], "arms": own, "tests": [], "as_good": []}
