"""Calibration as a person starts it: which sensors it takes, what it says, what it refuses."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from uniforce_cli.calibrate import CalibrateCommand, main, recorded_grasps
from uniforce_datasets.readers.recording import PairRecording
from uniforce_datasets.readers.uniforce_pairs import write_uniforce_pairs
from uniforce_vtla.tokenizer import Latent, Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration


@pytest.mark.slow
def test_a_unit_learns_to_read_as_another_one_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Unit 12 of a TacTip is stiffer and answers to the same grasp by .84 of unit 1."""
    out = tmp_path / "map"
    assert main(["new=tactip:12", "anchor=tactip:1", "grasps=120", f"out={out}"]) == 0
    assert "tactip:12 against tactip:1" in capsys.readouterr().out
    found = Calibration.load(out, Tokenizer.from_pretrained().hash)
    assert (found.new, found.anchor) == ("tactip:12", "tactip:1")
    for judged in found.agreement.values():
        assert judged.r2[2] > 0.95 and judged.r2[2] > judged.r2_before[2]


@pytest.mark.slow
def test_a_grasp_that_the_canonicaliser_refuses_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A pad of four tenths its stiffness moves markers further than any that pretraining saw, in the firmest grasps."""
    assert main(["new=tactip:1+stiffness=0.4", "anchor=tactip:1", "grasps=120", f"out={tmp_path / 'map'}"]) == 0
    assert "of 120 grasps are left out" in caplog.text


@pytest.mark.parametrize("words", ["tactip:any", "tactip:left", "nose:3"])
def test_only_a_sensor_that_stays_the_same_is_calibrated(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"new={words}"]) == 2
    assert words.partition(":")[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("sensors", "new_is"),
    [(("tactip", "gelsight"), "left"), (("gelsight", "tactip"), "right"), (("tactip_l", "tactip_r"), "left")],
)
def test_recorded_pairs_of_two_units_of_a_kind_are_kept_apart(
    sensors: tuple[str, str], new_is: str, tmp_path: Path
) -> None:
    images = np.zeros((3, 480, 640), np.uint8)
    images[:, 200:280, 280:360] = 255
    recording = PairRecording(sensors, "tool", "", images[0], images[0], images, images)
    write_uniforce_pairs(tmp_path, recording, "marker")  # folders named as `uniforce pairs` names them
    value = {"left": 1.0, "right": 2.0}
    tokenizer = SimpleNamespace(encode=lambda ref, now, finger: Latent.of(torch.full((3, 64, 6), value[finger]), "abc"))
    anchor = "gelsight" if "gelsight" in sensors else "tactip:1"
    config = CalibrateCommand(new="tactip:7", anchor=anchor, pairs=str(tmp_path))
    grasps = recorded_grasps(config, tokenizer)  # type: ignore[arg-type]
    assert grasps.classes == ("tool",) * 3 and len(grasps.new) == 3
    assert float(grasps.new.mean()) == value[new_is] and float(grasps.anchor.mean()) != value[new_is]
