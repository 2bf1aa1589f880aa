"""Grasps of two uSkins: where the object falls is free air, the other trials borrow it, a damaged
log is named."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real.uskin_grasps import DROPPED, LENDER, LOGS, find_uskin_grasps, read_scans
from uniforce_vtla.contact import TactileSimulator
from uniforce_vtla.errors import DatasetError

TRIALS = Path(__file__).parents[2].parent / "shared" / "real" / "uskin_bilateral_slip" / "data_set"
HELD = 60  # scans
FREE = 12


def write_log(path, scans):
    path.parent.mkdir(parents=True, exist_ok=True)
    header = ",".join(f"txl{taxel}_{axis}" for taxel in range(1, 17) for axis in "xyz")
    np.savetxt(path, scans.reshape(-1, 48), delimiter=",", header=header, comments="", fmt="%d")


@pytest.fixture
def folder(tmp_path):
    rest = TactileSimulator("uskin").raw_reference()
    free = rest + np.random.default_rng(0).integers(-5, 6, (FREE, 16, 3))
    held = np.repeat(free[:1], HELD, axis=0)
    held[:, :8, 2] -= 1500
    for name in (LENDER, "held_throughout"):
        scans = np.concatenate([held, free]) if name in DROPPED else held
        for log in LOGS.values():
            write_log(tmp_path / name / log, scans)
    return tmp_path


def test_contact_is_read_and_borrowed_references_are_marked(folder):
    found = list(find_uskin_grasps(folder))
    groups = {grasp.held: grasp.group for grasp in found}
    assert groups == {LENDER: "uskin", "held_throughout": "uskin, borrowed"}
    for grasp in found:
        assert grasp.current["left"].shape == (10, 480, 640)  # scans in free air are left out
        assert (grasp.current["right"] != grasp.reference["right"]).sum() > 1000


def test_a_damaged_log_is_named(folder):
    (folder / LENDER / LOGS["left"]).write_text("txl1_x\n1,2,3\n")
    with pytest.raises(DatasetError, match="48 counts"):
        next(find_uskin_grasps(folder))


def test_a_missing_log_is_named(tmp_path):
    with pytest.raises(DatasetError, match="48 counts"):
        read_scans(tmp_path / "nothing.csv")


@pytest.mark.real
@pytest.mark.skipif(not TRIALS.is_dir(), reason=f"recordings not found at {TRIALS}")
def test_real_trials_are_read():
    found = list(find_uskin_grasps(TRIALS))
    assert len(found) == 7
    assert sum("borrowed" in grasp.group for grasp in found) == 5
