"""A rehearsal of recording pairs."""

import json

import pytest

from benchmarks.pair_quality import main as pair_quality
from uniforce_cli.pairs import main

QUICK = ["left_sensor=uskin", "right_sensor=tactip", "indenters=sphere", "chunk=6", "crowded=1"]


def test_a_rehearsal_records_goes_on_and_says_what_the_truth_is(tmp_path, capsys):
    assert main([*QUICK, "pairs=6", f"out={tmp_path}"]) == 0
    assert main([*QUICK, "pairs=12", f"out={tmp_path}"]) == 0
    said = capsys.readouterr().out
    assert "12 pairs in" in said and "rehearsal, by truth" in said
    session = json.loads((tmp_path / "session.json").read_text())
    assert (
        session["pairs"] == {"sphere": 12}
        and session["truth"]["kept"] == session["frames"]["kept"] == 6
    )


@pytest.mark.parametrize("wrong", ["indenters=banana", "indenters=sphere,sphere"])
def test_what_makes_no_sense_is_refused_in_words(tmp_path, refuses, wrong):
    refuses(main, [*QUICK, f"out={tmp_path / 'new'}", wrong], "expected")


def test_the_score_is_measured_and_written(tmp_path):
    out = tmp_path / "score.json"
    given = ["rigs=uskin+tactip", "sessions=1", "grasps=2", "indenters=sphere,line", f"out={out}"]
    assert pair_quality(given) == 0
    content = json.loads(out.read_text())
    assert content["all_faults"]["pairs"] == 180
    assert sum(row["pairs"] for row in content["by_fault"].values()) == 180
    assert pair_quality(["rigs=uskin", f"out={out}"]) == 2
