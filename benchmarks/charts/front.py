"""Points of a chart, which of them no other one beats on both axes, and the picture."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uniforce_vtla.figure_file import save_figure

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


def publish(
    points: Sequence[Point], path: Path, title: str, cost: str, score: str
) -> dict[str, Any]:
    """Draw the chart into ``path`` and print its points, a star on the front; return what a result file says of it."""
    draw_chart(points, path, title, cost, score)
    best = front(points)
    for point in points:
        star = "*" if point.name in best else " "
        print(
            f"{star} {point.name:10} {point.cost:8.2f} {cost}: {point.score:.3f} [{point.low:.3f}, {point.high:.3f}]"
        )
    return {
        "cost": cost,
        "score": score,
        "points": [asdict(point) for point in points],
        "pareto_front": best,
    }


def draw_chart(points: Sequence[Point], path: Path, title: str, cost: str, score: str) -> Path:
    """Draw points with their spans over cost, the front as a line and the default filled; return ``path``."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    plot = figure.subplots()
    best = sorted(
        (point for point in points if point.name in front(points)), key=lambda point: point.cost
    )
    plot.plot(
        [p.cost for p in best], [p.score for p in best], color="0.7", zorder=0, label="Pareto front"
    )
    for point in points:
        span = [[point.score - point.low], [point.high - point.score]]
        fill = "C0" if point.default else "white"
        plot.errorbar(
            point.cost,
            point.score,
            yerr=span,
            marker="o",
            color="C0",
            markerfacecolor=fill,
            capsize=2,
        )
        plot.annotate(
            point.name,
            (point.cost, point.score),
            xytext=(3, 4),
            textcoords="offset points",
            fontsize=8,
            rotation=40,
        )
    plot.set(title=title, xlabel=cost, ylabel=score, xscale="log")
    plot.grid(alpha=0.3)
    plot.margins(x=0.15, y=0.2)  # room for names
    plot.legend(loc="lower right")
    return save_figure(figure, path)
