"""Calibration as a person starts it: which sensors it takes, what it says, what it refuses."""

from pathlib import Path

import pytest

from uniforce_cli.calibrate import main
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration


@pytest.mark.slow
def test_a_unit_learns_to_read_as_another_one_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Units 7 and 1 of a TacTip answer to the same grasp by 1.4 to 1."""
    out = tmp_path / "map"
    assert main(["new=tactip:7", "anchor=tactip:1", "grasps=120", f"out={out}"]) == 0
    assert "tactip:7 against tactip:1" in capsys.readouterr().out
    found = Calibration.load(out, Tokenizer.from_pretrained().hash)
    assert (found.new, found.anchor) == ("tactip:7", "tactip:1")
    for judged in found.agreement.values():
        assert judged.r2[2] > 0.9 > judged.r2_before[2]


@pytest.mark.parametrize("words", ["tactip:any", "tactip:left", "nose:3"])
def test_only_a_sensor_that_stays_the_same_is_calibrated(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"new={words}"]) == 2
    assert words.partition(":")[0] in capsys.readouterr().err
