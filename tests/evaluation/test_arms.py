from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uniforce_vtla.evaluation.arms import (
    OUTCOMES,
    PROFILE_POINTS,
    EpisodeRow,
    read_rows,
    summarise,
    table,
    write_row,
    z_profile,
)
from uniforce_vtla.evaluation.episode import STEP_FIELDS, EpisodeTrace
from uniforce_vtla.evaluation.pictures import draw_arms


def row(seed: int, outcome: str = "success", clean: bool = True) -> EpisodeRow:
    return EpisodeRow(seed, outcome, clean, not clean, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0)


@given(st.lists(st.sampled_from(OUTCOMES), min_size=1, max_size=30))
def test_outcomes_sum_to_n(outcomes: list[str]) -> None:
    report = summarise("V", [row(i, o, o == "success") for i, o in enumerate(outcomes)])
    assert sum(report.count(o) for o in OUTCOMES) == report.n
    assert report.as_dict()["clean"] == outcomes.count("success")


def test_rows_survive_a_line_cut_short(tmp_path: Path) -> None:
    file = tmp_path / "episodes.jsonl"
    write_row(file, row(3))
    write_row(file, row(4, "residual", False))
    with file.open("a") as handle:
        handle.write('{"seed": 5, "outc')
    assert read_rows(file) == {3: row(3), 4: row(4, "residual", False)}


def test_table_and_picture_show_every_arm(tmp_path: Path) -> None:
    reports = [summarise("V", [row(0, "residual", False)]), summarise("V+T", [row(0)])]
    text = table(reports)
    assert "| V | 0/1 = 0 %" in text and "| V+T | 1/1 = 100 %" in text
    assert draw_arms(reports, tmp_path / "arms.png", "t").stat().st_size > 1000


def trace(press_N: list[float], tool_z_mm: list[float], phase: list[int]) -> EpisodeTrace:
    fields = dict.fromkeys(STEP_FIELDS, np.zeros(len(phase)))
    given = {"press_N": press_N, "tool_z_mm": tool_z_mm, "phase": phase}
    return EpisodeTrace(**fields | {k: np.asarray(v) for k, v in given.items()}, rated_depth_mm=(1.5, 5.0))


def test_a_profile_ends_with_the_last_contact_and_keeps_what_was_lifted_between() -> None:
    """The lift at the end is twenty times as high as anything the wipe itself shows."""
    heights = [30.0, 8.0, 9.0, 20.0, 8.5, 8.0, 25.0, 40.0]
    wipe = trace([0.0, 5.0, 6.0, 0.0, 6.0, 5.0, 0.0, 0.0], heights, [1, 2, 2, 2, 2, 2, 2, 3])
    profile = z_profile(wipe)
    assert len(profile) == PROFILE_POINTS and profile[0] == 8.0 and profile[-1] == 8.0
    assert 19 < max(profile) <= 20
    assert z_profile(trace([0.0] * 3, [8.0] * 3, [2, 2, 2])) == ()  # never touched the board
