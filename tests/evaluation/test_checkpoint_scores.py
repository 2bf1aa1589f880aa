"""A checkpoint's card tells its own scenes, nobody else's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.checkpoint_scores import scores_of
from uniforce_vtla.evaluation.plan import ARMS, RECIPES, SCRIPTS

ROOT = Path(__file__).parents[2]
TABLE: dict[str, Any] = {
    "level": "paper",
    "checkpoints": ["arms/seed0", "arms/seed1"],
    "arms": {"V": {"by_seed": "CCCCC"}, "V+T": {"by_seed": "CsrCf"}, "V+U": {"by_seed": "saCCC"}},
    "tests": ["of both"],
    "as_good": ["of both"],
}


def test_scenes_of_the_own_turn_alone() -> None:
    first, second = scores_of(TABLE, "arms/seed0/vt"), scores_of(TABLE, "arms/seed1/vt")
    assert first["arms"]["V+T"] == {"n": 3, "clean": 1, "success": 1, "by_seed": "Crf"}
    assert second["arms"]["V+T"] == {"n": 2, "clean": 1, "success": 2, "by_seed": "sC"}
    assert list(first["arms"]) == ["V+T", "V+U"] and first["tests"] == first["as_good"] == []


@pytest.mark.parametrize("checkpoint", ["vt", "arms/seed2/vt", "arms/seed0/vtg", "arms/seed0/expert"])
def test_a_checkpoint_that_was_not_scored_is_refused(checkpoint: str) -> None:
    with pytest.raises(ContractError, match="as it was scored"):
        scores_of(TABLE, checkpoint)


def test_the_committed_table_adds_up() -> None:
    """Both seeds' scenes together are the arm's, for every arm of a policy."""
    table = json.loads((ROOT / "docs/results/wiping.json").read_text())
    for arm in (arm for arm in ARMS if arm.checkpoint not in SCRIPTS):
        parts = [
            scores_of(table, f"{seed}/{arm.checkpoint}")["arms"][arm.name] for seed in table["checkpoints"]
        ]
        whole = table["arms"][arm.name]
        assert sum(part["clean"] for part in parts) == whole["clean"]
        assert sum(part["success"] for part in parts) == whole["success"]
        assert [f"{part['clean']}/{part['n']}" for part in parts] == whole["clean_by_checkpoint"]
    assert {arm.checkpoint for arm in ARMS} == {*RECIPES, *SCRIPTS}
