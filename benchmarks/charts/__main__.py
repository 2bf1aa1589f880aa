"""Measure a family of settings, write chart_NAME.json and its picture."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from benchmarks.charts.tokenizer import accuracies, latencies_ms, name_of
from benchmarks.probes.labelled_set import ARRAYS, LabelledSet
from benchmarks.probes.report_sets import REPORT_SETS
from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.options import Count, CountOrZero, OutFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer

TIE = 0.005  # of the score: a smaller difference is none


@dataclass(frozen=True)
class Point:
    """One setting, measured."""

    name: str
    cost: float  # less is better
    score: float  # more is better
    low: float  # of the score: the worst cell, or an interval's end
    high: float
    default: bool = False


def front(points: Sequence[Point]) -> list[str]:
    """Return the names of points that no other one beats: cheaper and at least as good, or as cheap and better."""
    return [one.name for one in points if not any(_beats(other, one) for other in points)]


def _beats(other: Point, one: Point) -> bool:
    no_worse = other.cost <= one.cost and other.score >= one.score - TIE
    return no_worse and (other.cost < one.cost or other.score > one.score + TIE)


def draw_chart(points: Sequence[Point], path: Path, title: str, cost: str, score: str) -> Path:
    """Draw points with their spans over cost, the front as a line and the default filled; return ``path``."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    plot = figure.subplots()
    best = sorted((point for point in points if point.name in front(points)), key=lambda point: point.cost)
    plot.plot([p.cost for p in best], [p.score for p in best], color="0.7", zorder=0, label="Pareto front")
    for point in points:
        span = [[point.score - point.low], [point.high - point.score]]
        fill = "C0" if point.default else "white"
        plot.errorbar(point.cost, point.score, yerr=span, marker="o", color="C0", markerfacecolor=fill, capsize=2)
        plot.annotate(
            point.name, (point.cost, point.score), xytext=(3, 4), textcoords="offset points", fontsize=8, rotation=40
        )
    plot.set(title=title, xlabel=cost, ylabel=score, xscale="log")
    plot.grid(alpha=0.3)
    plot.margins(x=0.15, y=0.2)  # room for names
    plot.legend(loc="lower right")
    return save_figure(figure, path)


OWN_MODEL, FINITE_ELEMENTS = SETS = ("zero_shot_v2", "fe_dev_v1")
DEFAULT = name_of("small", "float32")


@dataclass
class ChartCommand:
    """Measure tokenizers by size and precision: time of two fingers on one core against zero-shot force.

    Example: python -m benchmarks.charts out=outputs/charts
    """

    rounds: Count = 9  # of timing, all points in turns
    sequences: CountOrZero = 0  # of each set and sensor, the first ones; 0 = all
    cache: OutFolder = "outputs/labelled"  # drawn sets
    out: OutFolder = "outputs/charts"


def frozen_set(name: str, config: ChartCommand) -> dict[str, LabelledSet]:
    """Return sensor → the first labelled sequences of a frozen set, all where ``config.sequences`` is 0."""
    chosen = REPORT_SETS[name]
    side = Tokenizer.from_pretrained().config.side
    drawn = chosen.draw(chosen.frozen, chosen.targets(), side, Path(config.cache))
    return {sensor: first(labelled, config.sequences or None) for sensor, labelled in drawn.items()}


def first(labelled: LabelledSet, count: int | None) -> LabelledSet:
    return replace(labelled, **{name: getattr(labelled, name)[:count] for name in ARRAYS})


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
    title, score = "tokenizer on finite elements, one core", "zero-shot Fz R², mean and worst transfer"
    draw_chart(shown[FINITE_ELEMENTS], path.with_suffix(".png"), title, "ms for two fingers", score)
    for name in SETS:
        for point in shown[name]:
            star = "*" if point.name in best[name] else " "
            print(f"{star} {name:14} {point.name:18} {point.cost:6.2f} ms  R² {point.score:.3f}  worst {point.low:.3f}")
    print(f"* on the front; written to {path}")


if __name__ == "__main__":
    sys.exit(main())
