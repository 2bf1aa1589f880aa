"""Figures are drawn from the committed results: every line has words and one sensor's colour."""

import shutil
from pathlib import Path

from benchmarks import figures
from uniforce_vtla.errors import ContractError
from uniforce_vtla.json_file import read_object

RESULTS = Path(__file__).parents[2] / "docs" / "results"


def test_all_are_drawn_from_the_committed_results(tmp_path):
    for file in RESULTS.glob("*.json"):
        shutil.copy(file, tmp_path)
    assert figures.main([f"results={tmp_path}"]) == 0
    drawn = {path.name for path in tmp_path.glob("*.png")}
    assert drawn == {"wiping.png", "stress.png", "reading_expert.png", "chart_policy.png"}


def test_lines_say_how_many_and_wear_their_sensors_colour():
    lines = figures.faults(read_object(RESULTS / "stress.json", ContractError))
    lag = next(line for line in lines if line.label == "TacTip 133 ms late")
    assert (lag.clean, lag.n, lag.colour) == (6, 25, figures.SENSOR_COLOURS["TacTip"])
    assert figures.Share("another uSkin", 1, 2).colour == figures.SENSOR_COLOURS["uSkin"]
    assert figures.Share("vision alone", 1, 2).colour == figures.OTHER
