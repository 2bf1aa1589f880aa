"""The hardness chart is drawn from the committed result's form."""

from __future__ import annotations

from pathlib import Path

from benchmarks.probes.hardness import variants
from benchmarks.probes.hardness_figure import draw_hardness


def test_chart_is_drawn(tmp_path: Path) -> None:
    cell = {"mae_N_paper_range": [0.1, 0.1, 0.9]}
    content = {"without": {name: {"transfers": cell, "self": cell} for name in variants()}, "oracle": cell}
    assert draw_hardness(content, tmp_path / "new" / "chart.png").stat().st_size > 10_000
