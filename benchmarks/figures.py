"""Draw the pages' figures from the result files that are committed.

One colour per sensor everywhere, shares with their 95 % intervals, labels in words.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter

from uniforce_cli.boundary import command
from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import FolderPath

SENSOR_COLOURS = {"TacTip": "#2a6f97", "uSkin": "#e07b39", "GelSight": "#2a9d8f"}
OTHER = "#444444"  # what feels with no sensor, or with the true force
ROW_inch = 0.34

# row of swap.json → words
LADDER = {
    "S0": "its own TacTip",
    "S1": "another TacTip",
    "S1 by grasps": "TacTips calibrated by grasps",
    "S1 weighed": "TacTips weighed",
    "S2 uskin": "another uSkin",
    "S2 uskin by grasps": "uSkins calibrated by grasps",
    "S2 uskin weighed": "uSkins weighed",
    "S2 gelsight": "another GelSight",
    "S2 gelsight by grasps": "GelSights calibrated by grasps",
    "S2 gelsight weighed": "GelSights weighed",
    "S2 both uskin": "uSkins on both fingers, calibrated",
    "S2 both gelsight": "GelSights on both fingers, calibrated",
    "frozen touch": "TacTip, frozen while it wipes",
    "vision alone": "nothing: vision alone",
}
# operator of stress.json → words with its dose
FAULTS = {
    "G1 stiffer": "TacTip {:g} × as stiff",
    "G1 softer": "TacTip {:g} × as stiff",
    "G2 keener": "TacTip {:g} × as sensitive",
    "G2 duller": "TacTip {:g} × as sensitive",
    "C2 shift": "TacTip's camera moved {:g} mm",
    "M1 markers lost": "TacTip: {:.0%} of the markers lost",
    "M2 flicker": "TacTip: {:.0%} of the markers missed",
    "F4 dead patch": "TacTip: {:.0%} of the pad dead",
    "R1 stale reference": "TacTip's reference under {:g} N",
    "T1 lag": "TacTip {:g} ms late",
    "T2 stall": "TacTip stalls for {:g} ms",
    "P1 late actions": "actions {:g} ms late",
    "P2 pushed arm": "arm pushed by {:g} N",
    "P3 stronger pull": "hidden pull × {:g}",
    "B1 rougher board": "board {:g} × as rough",
    "B2 board friction": "board's friction × {:g}",
    "B3 pads slip": "pads' friction × {:g}",
    "E1 heavier eraser": "eraser {:g} × as heavy",
    "E2 wider eraser": "eraser {:g} mm wider",
    "X1 unit exchanged in mid-wipe": "another TacTip from mid-wipe on",
    "W1 other words": "other words for the task",
}


@dataclass
class FiguresCommand:
    """Draw every figure whose results are there.

    Example: python -m benchmarks.figures
    """

    results: FolderPath = "docs/results"  # of the result files; figures go there too


@dataclass(frozen=True)
class Share:
    """A line of a figure: how many of n are clean."""

    label: str
    clean: int
    n: int

    @property
    def colour(self) -> str:
        """Colour of the first sensor that the label names."""
        for sensor, colour in SENSOR_COLOURS.items():
            if sensor in self.label:
                return colour
        return OTHER


def percent(clean: int, n: int) -> tuple[float, float, float]:
    """Return a share in %, and how far its 95 % interval reaches below and above."""
    found = wilson(clean, n)
    middle = 100 * clean / n
    return middle, middle - 100 * found.low, 100 * found.high - middle


def draw_shares(shares: Sequence[Share], path: Path, line: float | None = None) -> Path:
    """Draw a dot and its 95 % interval per line, the first on top; ``line`` is marked, in %."""
    figure = Figure(figsize=(7.5, 0.9 + ROW_inch * len(shares)), layout="constrained")
    axes = figure.subplots()
    if line is not None:
        axes.axvline(line, color="0.6", lw=1, ls="--")
    for place, share in enumerate(shares):
        middle, below, above = percent(share.clean, share.n)
        reach = [[below], [above]]
        axes.errorbar(middle, place, xerr=reach, fmt="o", color=share.colour, capsize=3)
    axes.set_yticks(range(len(shares)), [f"{s.label}  ({s.clean} of {s.n})" for s in shares])
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.3)
    axes.set(xlim=(-2, 102), xlabel="clean wipes, % (bar: 95 % interval), simulated")
    return save_figure(figure, path)


def ladder(found: Mapping[str, Any], scripts: Mapping[str, Any]) -> list[Share]:
    """Return the lines of the ladder, and of the best of the scripts that act without touch."""
    shares = []
    for name, label in LADDER.items():
        row = found["rows"].get(name)
        if row is not None:
            shares.append(Share(label, row["clean"], row["n"]))
    best = max(scripts["must_fail"].values(), key=lambda row: row["clean"] / row["n"])
    return [*shares, Share("nothing: the best script", best["clean"], best["n"])]


def faults(found: Mapping[str, Any]) -> list[Share]:
    """Return a line per fault and dose."""
    shares = []
    for name, row in found["operators"].items():
        for dose, clean, n in zip(row["doses"], row["clean"], row["n"], strict=True):
            shares.append(Share(FAULTS[name].format(dose), clean, n))
    return shares


def readers(found: Mapping[str, Any]) -> list[Share]:
    """Return a line per sensor that the expert reads."""
    shares = []
    for name, row in found["hand"]["readers"].items():
        shares.append(Share(name, row["clean"], row["n"]))
    return shares


def draw_front(found: Mapping[str, Any], path: Path) -> Path:
    """Draw a score in % against its cost, a point per setting with its 95 % interval."""
    figure = Figure(figsize=(6.5, 3.8), layout="constrained")
    axes = figure.subplots()
    for point in found["points"]:
        score = 100 * point["score"]
        reach = [[score - 100 * point["low"]], [100 * point["high"] - score]]
        shape = "o" if point["default"] else "s"
        axes.errorbar(point["cost"], score, yerr=reach, fmt=shape, color=OTHER, capsize=3)
        label = point["name"] + (", the default" if point["default"] else "")
        axes.annotate(label, (point["cost"], score), (6, -12), textcoords="offset points")
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.margins(x=0.15)
    axes.grid(alpha=0.3)
    axes.set(xlabel=found["cost"], ylabel="clean wipes, %", ylim=(-2, 105))
    return save_figure(figure, path)


@command(FiguresCommand)
def main(config: FiguresCommand) -> None:
    folder = Path(config.results)

    def read(name: str) -> dict[str, Any]:
        return read_object(folder / f"{name}.json", ContractError)

    stress = read("stress")
    usual = next(iter(stress["clean_without_fault"].values()))
    kept = 100 * usual["clean"] / usual["n"]
    made = [
        draw_shares(ladder(read("swap"), read("gates_hand")), folder / "wiping.png"),
        draw_shares(faults(stress), folder / "stress.png", kept),
        draw_shares(readers(read("reading_expert")), folder / "reading_expert.png"),
        draw_front(read("chart_policy"), folder / "chart_policy.png"),
    ]
    for path in made:
        print(f"drawn: {path}")


if __name__ == "__main__":
    sys.exit(main())
