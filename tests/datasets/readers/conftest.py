"""Small data sets in each format, drawn by the simulator and written here: nothing is read from the network."""

from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.probes.labelled_set import force_sequences

COLUMNS = ["Fx(N)", "Fy(N)", "Fz(N)", "Tx(Nmm)", "Ty(Nmm)", "Tz(Nmm)"]
LENGTH = 6


@dataclass(frozen=True)
class MarkerTrial:
    sensor: str
    indenter: str
    reference: np.ndarray
    frames: np.ndarray
    force_N: np.ndarray


@pytest.fixture(scope="session")
def marker_trials():
    """One trial per sensor and indenter, sphere (seen) and wave (unseen); frame 0 is the reference itself."""
    return tuple(
        _marker_trial(s, i) for s in ("gelsight", "tactip", "uskin") for i in ("sphere", "wave")
    )


@pytest.fixture
def genforce(tmp_path, marker_trials):
    root = tmp_path / "release" / "dataset" / "training" / "hetero"
    for trial in marker_trials:
        write_genforce_trial(root, trial)
    return tmp_path / "release"


def write_genforce_trial(root, trial, name="1"):
    images = root / "img" / trial.sensor / trial.indenter / name
    forces = root / "force" / trial.sensor / trial.indenter / name
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
    table = pd.DataFrame(np.hstack([recorded, np.full((len(recorded), 3), 9.0)]), columns=COLUMNS)
    table.to_csv(forces / "ft.csv", index=False)


def _marker_trial(sensor, indenter):
    rng = np.random.default_rng([3, len(sensor), len(indenter)])
    batch = force_sequences(rng, sensor, 1, LENGTH, (indenter,), unit_strength=0.3, units=1)
    frames = np.concatenate([batch.reference, batch.frames[0, 1:]])
    force_N = batch.force_N[0].copy()
    force_N[0] = 0
    return MarkerTrial(sensor, indenter, batch.reference[0], frames, force_N)
