"""How long reading the robot takes at 30 Hz, without cameras: LeRobot's ``get_observation`` while actions are sent."""

import time
from pathlib import Path

import numpy as np

from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.recorder.ticker import Ticker

RATE_HZ = 30.0
BOX = GuardLimits(low=(0.1, -0.3, 0.1, -np.pi, 0.0), high=(0.7, 0.3, 0.6, np.pi, 0.08))


def measure(address: str, seconds: float, folder: Path) -> dict[str, float]:
    """Return percentiles of the time one read takes."""
    config = UniforceFrankaConfig(id="trial", calibration_dir=folder, address=address, guards=BOX)
    robot, ticker, took_ms = UniforceFranka(config), Ticker(RATE_HZ), []
    robot.connect()
    try:
        for _ in range(round(seconds * RATE_HZ)):
            ticker.wait()
            begun_s = time.perf_counter()
            seen = robot.get_observation()
            took_ms.append(1e3 * (time.perf_counter() - begun_s))
            robot.send_action(seen)
    finally:
        robot.disconnect()
    p50, p95, p99 = np.percentile(took_ms, (50, 95, 99)).tolist()
    return {"reads": len(took_ms), "p50_ms": round(p50, 3), "p95_ms": round(p95, 3), "p99_ms": round(p99, 3)}
