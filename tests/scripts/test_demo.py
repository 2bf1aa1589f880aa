"""The demo's choices; ``make demo`` itself is run by hand and before every release."""

from __future__ import annotations

from pathlib import Path

import pytest

from uniforce_cli import demo, record, view
from uniforce_datasets.view_plan import EpisodeFacts


class SeenEnoughError(Exception):
    """Ends the demo where a test has seen enough."""


def test_it_learns_from_every_demo_that_wiped_the_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nudged experts have an event in half of the demos: of three, all may have one, and the demo ended there."""
    asked = []

    def stop(config: view.ViewConfig) -> Path:
        asked.append(config)
        raise SeenEnoughError

    monkeypatch.setattr(record, "record", lambda config: None)
    monkeypatch.setattr(view, "make_view", stop)
    with pytest.raises(SeenEnoughError):
        demo.run(demo.DemoConfig(out=str(tmp_path / "demo")))
    wiped, left_ink = (
        EpisodeFacts("demos", 0, 400, "wipe", False, outcome, 0, "gelsight", "tactip")
        for outcome in ("success", "residual")
    )
    assert view.chosen(wiped, asked[0]) and not view.chosen(left_ink, asked[0])
