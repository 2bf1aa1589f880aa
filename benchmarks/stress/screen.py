"""Readings of the policy under each fault.  Seconds per cell, so that only cells near a cliff are rolled out."""

from typing import Any

import numpy as np

from benchmarks.stress.other_readers import Readers, features_of
from benchmarks.stress.readings import Readings, read_scenes
from lerobot_env_uniforce_wiping.expert import GRAVITY_m_s2
from lerobot_env_uniforce_wiping.levels import get_level
from uniforce_vtla.errors import SensorError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

AT_N = 6.0  # middle of the band
PRESSED_N = 1.0
FEWEST = 20  # readings that a line can be fitted to


def screen_cell(
    level: str,
    sensor: str,
    seeds: range,
    tokenizer: Tokenizer,
    head: ForceHead,
    readers: Readers | None = None,
) -> dict[str, Any]:
    """Return what is read of a press of 6 N, its slope and scatter, the error of the grip, and what others read."""
    readers = readers or {}
    also = features_of(tokenizer) if readers else {}
    try:
        found = read_scenes(level, "right", sensor, seeds, tokenizer, also)
    except SensorError as error:
        return {"refused_share": 1.0, "why": str(error)}
    total = len(found.press_N) + found.refused
    share = {"refused_share": round(found.refused / max(total, 1), 4)}
    if len(found.press_N) < FEWEST:
        return share
    pressed = found.press_N > PRESSED_N
    others = {
        name: reader.predict(found.features[name][pressed]) for name, reader in readers.items()
    }
    at_6_N = {
        name: round(_at_6(found.press_N[pressed], read)[0], 3) for name, read in others.items()
    }
    return {
        **share,
        **_line(found, head, level),
        **({"others_read_at_6_N": at_6_N} if readers else {}),
    }


def _at_6(press_N: np.ndarray, read_N: np.ndarray) -> tuple[float, float, float]:
    """Return what is read of a press of 6 N, N; the slope of a line through the readings; their scatter about it, N."""
    slope, offset = np.polyfit(press_N, read_N, 1)
    return (
        float(slope * AT_N + offset),
        float(slope),
        float(np.std(read_N - slope * press_N - offset)),
    )


def _line(found: Readings, head: ForceHead, level: str) -> dict[str, float]:
    # press = weight + what both pads push down
    weight_N = get_level(level).layout.eraser_mass_kg * GRAVITY_m_s2
    read = head(found.latent).numpy()
    pressed = found.press_N > PRESSED_N
    at_6_N, slope, scatter = _at_6(found.press_N[pressed], weight_N - 2 * read[pressed, 1])
    numbers = {
        "press_read_at_6_N": at_6_N,
        "press_slope": slope,
        "press_scatter_N": scatter,
        "grip_error_N": (read[:, 2] - found.truth_N[:, 2]).mean(),
    }
    return {name: round(float(value), 3) for name, value in numbers.items()}


def against(cell: dict[str, Any], usual: dict[str, Any]) -> float | None:
    """Return by how much the press is misread beside the same sensor without the fault, N; None where refused."""
    if "press_read_at_6_N" not in cell or cell["refused_share"] > 0.05:
        return None
    return float(cell["press_read_at_6_N"] - usual["press_read_at_6_N"])


def others_against(cell: dict[str, Any], usual: dict[str, Any]) -> dict[str, float]:
    """Return the same of other readers; nothing where frames were refused."""
    read, before = (one.get("others_read_at_6_N", {}) for one in (cell, usual))
    return {name: round(read[name] - before[name], 3) for name in read if name in before}
