"""Small data sets in each format, drawn by the simulator and written here: nothing is read from the
network."""

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.probes.labelled_set import force_sequences
from uniforce_datasets.readers import LabelledRecording

COLUMNS = ["Fx(N)", "Fy(N)", "Fz(N)", "Tx(Nmm)", "Ty(Nmm)", "Tz(Nmm)"]
LENGTH = 6


@pytest.fixture(scope="session")
def marker_trials():
    """One trial per sensor and indenter, sphere (seen) and wave (unseen); frame 0 is the reference
    itself."""
    return tuple(
        _marker_trial(s, i) for s in ("gelsight", "tactip", "uskin") for i in ("sphere", "wave")
    )


@pytest.fixture
def genforce(tmp_path, marker_trials):
    for trial in marker_trials:
        _write_trial(tmp_path / "release" / "dataset" / "training" / "hetero", trial)
    return tmp_path / "release"


def _write_trial(root, trial):
    images = root / "img" / str(trial)
    forces = root / "force" / str(trial)
    images.mkdir(parents=True)
    forces.mkdir(parents=True)
    for index, frame in enumerate(trial.frames):
        if trial.sensor == "uskin":
            cv2.imwrite(str(images / f"{index:04d}.jpg"), frame, [cv2.IMWRITE_JPEG_QUALITY, 100])
        else:
            np.save(images / f"{index:04d}.npy", np.packbits(frame.ravel() > 0))
    (images / "last.csv").write_text("0001,0003,0004,0005\n")
    # the rig's Fz is negative in compression
    recorded = trial.force_N.astype(np.float64) * (1, 1, -1)
    table = pd.DataFrame(np.hstack([recorded, np.full_like(recorded, 9.0)]), columns=COLUMNS)
    table.to_csv(forces / "ft.csv", index=False)


def _marker_trial(sensor, indenter):
    rng = np.random.default_rng([3, len(sensor), len(indenter)])
    batch = force_sequences(rng, sensor, 1, LENGTH, (indenter,), unit_strength=0.3, units=1)
    batch.frames[0, 0] = batch.reference[0]
    batch.force_N[0, 0] = 0
    return LabelledRecording(
        sensor, indenter, "1", batch.reference[0], batch.frames[0], batch.force_N[0]
    )
