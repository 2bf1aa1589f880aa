"""What would the policy read?  Seconds per cell, so that only cells near a cliff are rolled out."""

from typing import Any

import numpy as np

from benchmarks.stress.readings import Readings, read_scenes
from lerobot_env_uniforce_wiping.expert import GRAVITY_m_s2
from lerobot_env_uniforce_wiping.levels import get_level
from uniforce_vtla.errors import SensorError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

AT_N = 6.0  # middle of the band
PRESSED_N = 1.0
FEWEST = 20  # readings that a line can be fitted to


def screen_cell(level: str, sensor: str, seeds: range, tokenizer: Tokenizer, head: ForceHead) -> dict[str, float | str]:
    """Return what is read of a press of 6 N, its slope and scatter, and the error of the grip."""
    try:
        found = read_scenes(level, "right", sensor, seeds, tokenizer)
    except SensorError as error:
        return {"refused_share": 1.0, "why": str(error)}
    total = len(found.press_N) + found.refused
    share = {"refused_share": round(found.refused / max(total, 1), 4)}
    return {**share, **({} if len(found.press_N) < FEWEST else _line(found, head, level))}


def _line(found: Readings, head: ForceHead, level: str) -> dict[str, float]:
    weight_N = get_level(level).layout.eraser_mass_kg * GRAVITY_m_s2  # press = weight + what both pads push down
    read = head(found.latent).numpy()
    pressed = found.press_N > PRESSED_N
    press = weight_N - 2 * read[pressed, 1]
    slope, offset = np.polyfit(found.press_N[pressed], press, 1)
    scatter = np.std(press - slope * found.press_N[pressed] - offset)
    numbers = {
        "press_read_at_6_N": slope * AT_N + offset,
        "press_slope": slope,
        "press_scatter_N": scatter,
        "grip_error_N": (read[:, 2] - found.truth_N[:, 2]).mean(),
    }
    return {name: round(float(value), 3) for name, value in numbers.items()}


def against(cell: dict[str, Any], usual: dict[str, Any]) -> float:
    """Return by how much the press is misread beside the same sensor without the fault, N; infinite where refused."""
    if "press_read_at_6_N" not in cell or cell["refused_share"] > 0.05:
        return float("inf")
    return float(cell["press_read_at_6_N"] - usual["press_read_at_6_N"])
