"""The table's picture holds whatever rows were measured, and leaves out a sensor read by its own head."""

from __future__ import annotations

from pathlib import Path

from benchmarks.probes.zero_shot_figure import draw_table


def test_any_rows_make_a_picture(tmp_path: Path) -> None:
    cell = {"r2": [0.9, -157.0, 0.1], "mae_N_paper_range": [0.1, 0.2, 3.0]}
    rows = {"ResNet": {"G->G": cell, "G->T": cell, "T->G": cell}, "UniForce": {"G->T": cell, "T->G": cell}}
    path = draw_table({"rows": rows, "set": "some_set"}, tmp_path / "deep" / "table.png")
    assert path.stat().st_size > 10_000
