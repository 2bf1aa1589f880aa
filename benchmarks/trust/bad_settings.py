"""Settings of the robot that must be refused, made from the table of hard limits: a new setting is tried, too."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from lerobot_robot_uniforce_franka.arm import ArmSettings, Gains
from lerobot_robot_uniforce_franka.config import UniforceFrankaConfig
from lerobot_robot_uniforce_franka.guards import GuardLimits
from lerobot_robot_uniforce_franka.hand import HandSettings
from lerobot_robot_uniforce_franka.limits import HARD_LIMITS, Range
from lerobot_robot_uniforce_franka.stream import StreamSettings
from uniforce_vtla.errors import ContractError

NEEDS: dict[type, dict[str, Any]] = {
    GuardLimits: {},
    StreamSettings: {},
    HandSettings: {},
    Gains: {"stiffness_N_m": (800.0, 800.0, 800.0)},
    ArmSettings: {"address": "127.0.0.2"},
    UniforceFrankaConfig: {},
}
TUPLES = {"low": 5, "high": 5, "stiffness_N_m": 3, "rotation_Nm_rad": 3, "clip_m": 3}
SOUND = {"low": 0.1, "high": 0.05, "stiffness_N_m": 100.0, "rotation_Nm_rad": 10.0, "clip_m": 0.01}


def bad_values(allowed: Range) -> list[Any]:
    """Return values outside a range, and values that are no numbers."""
    outside = [allowed.low - 1.0, allowed.high * 1.01 + 1e-6, -abs(allowed.high) - 1.0, 1e9]
    edge = [allowed.low] if allowed.above else []
    return [math.nan, math.inf, -math.inf, "0.1", None, True, *outside, *edge]


def bad_settings() -> Iterator[tuple[type, dict[str, Any], str]]:
    """Yield (class, keyword arguments, the field that is wrong)."""
    for kind, needed in NEEDS.items():
        for name, allowed in HARD_LIMITS[kind.__name__].items():
            row = allowed[0] if isinstance(allowed, tuple) else allowed
            for value in bad_values(row):
                yield kind, needed | {name: _placed(name, value)}, name
            if name in TUPLES:
                yield kind, needed | {name: (0.1,)}, name
    yield GuardLimits, {"low": (0.5, 0, 0, 0, 0), "high": (0.4, 0.1, 0.1, 0.1, 0.05)}, "low"
    yield Gains, {"stiffness_N_m": (3000.0,) * 3, "clip_m": (0.05,) * 3}, "gains"
    yield Gains, {"stiffness_N_m": (100.0,) * 3, "rotation_Nm_rad": (300.0,) * 3, "clip_rad": 0.5}, "gains"
    yield UniforceFrankaConfig, {"backend": "ros"}, "backend"
    yield UniforceFrankaConfig, {"realtime": "please"}, "realtime"


def _placed(name: str, value: Any) -> Any:
    """Return a tuple with the value in its first place, where the field is a tuple."""
    return (value, *[SOUND[name]] * (TUPLES[name] - 1)) if name in TUPLES else value


def try_all() -> dict[str, Any]:
    """Return how many were tried and refused, and those that were accepted."""
    tried, accepted = 0, []
    for kind, settings, field in bad_settings():
        tried += 1
        try:
            kind(**settings)
        except ContractError as error:
            if field in str(error) or "box" in str(error):
                continue
            accepted.append(f"{kind.__name__}({settings}): refused without its name: {error}")
        else:
            accepted.append(f"{kind.__name__}({settings})")
    return {"tried": tried, "refused": tried - len(accepted), "accepted": accepted}
