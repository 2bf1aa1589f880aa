from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.probes.latent_correlation import Rotation
from benchmarks.probes.real_balance import balance_report
from benchmarks.probes.real_slip_figure import draw_real_slip
from benchmarks.probes.real_trials import Signals, SlipConfig, Trial
from benchmarks.probes.slip_detector import slip_report

T = 40


def trial(name: str, seed: int) -> tuple[Trial, Signals]:
    rng = np.random.default_rng(seed)
    slip = np.zeros(T, bool)
    slip[10:20] = True
    load = np.linspace(0, 200, T)[:, None, None]
    counts = np.repeat((load * (0, 0, 1))[None], 2, axis=0) + rng.standard_normal((2, T, 16, 3))
    latent = rng.standard_normal((2, T, 4, 6)) * (1 + slip)[:, None, None]
    signals = Signals(latent, rng.standard_normal((2, T, 6)), counts, 0)
    reference = np.zeros((2, 16, 3), np.int64)
    return Trial(name, counts, slip, np.zeros(T, bool), rng.random(T), reference, "own"), signals


def test_every_part_is_drawn(tmp_path: Path) -> None:
    config, rotation = SlipConfig(), Rotation("uskin", np.eye(6))
    trials, signals = zip(*(trial(name, seed) for seed, name in enumerate("abc")), strict=True)
    slip, scores = slip_report(trials, signals, config)
    report = {"balance": balance_report(trials, signals, rotation, config), "slip": slip}
    path = draw_real_slip(report, trials, signals, scores, rotation, tmp_path / "real.png")
    picture = cv2.imread(str(path))
    blue = (picture[..., 0].astype(int) - picture[..., 2] > 80).any(axis=1)
    height = len(picture)
    assert all(blue[int(height * k / 4) : int(height * (k + 1) / 4)].any() for k in range(4))
