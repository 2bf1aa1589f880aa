"""Which recorded episodes a training view takes."""

from __future__ import annotations

import pytest

from uniforce_cli.view import ViewConfig, chosen
from uniforce_datasets.view_plan import EpisodeFacts

CLEAN, EVENT, FAILED, ABORTED = (True, "success"), (False, "success"), (False, "residual"), (False, "aborted")


@pytest.mark.parametrize(
    ("settings", "taken"),
    [
        ({}, [CLEAN]),
        ({"keep_events": True}, [CLEAN, EVENT]),
        ({"keep_failures": True}, [CLEAN, EVENT, FAILED, ABORTED]),
    ],
)
def test_clean_demos_always_others_when_asked_for(
    settings: dict[str, bool], taken: list[tuple[bool, str]]
) -> None:
    def facts(success: bool, outcome: str) -> EpisodeFacts:
        return EpisodeFacts("demos", 0, 300, "wipe", success, outcome, 0, "gelsight", "tactip")

    every = (CLEAN, EVENT, FAILED, ABORTED)
    assert [end for end in every if chosen(facts(*end), ViewConfig(**settings))] == taken
