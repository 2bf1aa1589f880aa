"""Measure a family of settings, write chart_NAME.json and its picture."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.charts.front import Point, draw_chart, front
from benchmarks.charts.tokenizer import accuracies, latencies_ms, name_of
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.report_sets import REPORT_SETS
from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer

OWN_MODEL, FINITE_ELEMENTS = SETS = ("zero_shot_v2", "fe_dev_v1")
DEFAULT = name_of("small", "float32")


@dataclass
class ChartCommand:
    """Measure tokenizers by size and precision: time of two fingers on one core against zero-shot force.

    Example: python -m benchmarks.charts out=outputs/charts
    """

    rounds: Count = 9  # of timing, all points in turns
    cache: OutFolder = "outputs/labelled"  # drawn sets
    out: OutFolder = "outputs/charts"


def frozen_set(name: str, config: ChartCommand) -> dict[str, LabelledSet]:
    """Return sensor → the labelled sequences of a frozen set."""
    chosen = REPORT_SETS[name]
    side = Tokenizer.from_pretrained().config.side
    return chosen.draw(chosen.frozen, chosen.targets(), side, Path(config.cache))


def points(times_ms: dict[str, float], scores: dict[str, dict[str, Any]]) -> list[Point]:
    """Return the chart's points; what isn't cached computes the same latents."""
    found = []
    for name, cost in times_ms.items():
        score = scores[name.replace("no cache", "float32")]
        mean, worst = score["fz_mean"], score["fz_worst"]
        found.append(Point(name, cost, mean, worst, mean, default=name == DEFAULT))
    return found


@command(ChartCommand)
def main(config: ChartCommand) -> None:
    one_thread()
    sets = {name: frozen_set(name, config) for name in SETS}
    times_ms = latencies_ms(next(iter(sets[OWN_MODEL].values())), config.rounds)
    scores = {name: accuracies(frozen) for name, frozen in sets.items()}
    shown = {name: points(times_ms, scores[name]) for name in SETS}
    best = {name: front(shown[name]) for name in SETS}
    content = {
        "family": "tokenizer",
        "cost": "ms for two fingers, one core, median",
        "default": DEFAULT,
        "points": {name: [asdict(point) for point in shown[name]] for name in SETS},
        "pareto_front": best,
        "scores": scores,
    }
    path = write_json(Path(config.out) / "chart_tokenizer.json", content | provenance())
    title, score = (
        "tokenizer on finite elements, one core",
        "zero-shot Fz R², mean and worst transfer",
    )
    draw_chart(shown[FINITE_ELEMENTS], path.with_suffix(".png"), title, "ms for two fingers", score)
    for name in SETS:
        for point in shown[name]:
            star = "*" if point.name in best[name] else " "
            print(
                f"{star} {name:14} {point.name:18} {point.cost:6.2f} ms  R² {point.score:.3f}  worst {point.low:.3f}"
            )
    print(f"* on the front; written to {path}")


if __name__ == "__main__":
    sys.exit(main())
