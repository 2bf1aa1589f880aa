"""Hard limits of every setting of the robot, and the settings of stream and hand.

No config lifts a limit; to allow more, change this file. With them a Franka Research 3 beside a
person stays slow and soft. Nothing here has been tried on hardware.
"""

from dataclasses import dataclass

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.hand import HandRules
from uniforce_vtla.options import Range


def up_to(most: float) -> Range:
    """Return what lies above 0, up to ``most``."""
    return Range(0, most, above=True)


# x, y m (the arm reaches 0.855), z m, yaw rad (joint 7 turns ±3.02), width m (at most 0.08)
BOX = (
    Range(-0.9, 0.9),
    Range(-0.9, 0.9),
    Range(-0.5, 1.2),
    Range(-3.2, 3.2),
    Range(0.0, 0.1),
)
FORCE_N = 60.0  # length of the spring's force, however the hand is turned about the vertical
TORQUE_Nm = 25.0  # length of its torque

HARD_LIMITS: dict[str, dict[str, Range | tuple[Range, ...]]] = {
    "GuardLimits": {
        "low": BOX,
        "high": BOX,
        "step_m": up_to(0.1),
        "step_rad": up_to(0.8),
        "speed_m_s": up_to(0.5),  # a collaborative arm beside a person: 0.25 by default
        "speed_rad_s": up_to(2.5),
        "speed_width_m_s": up_to(0.2),
        "longest_gap_s": up_to(0.2),
        "tilt_rad": up_to(0.35),
    },
    "StreamSettings": {
        "rate_hz": Range(50, 1000),
        "action_period_s": Range(0.005, 0.2),
        "stale_s": Range(0.02, 1.0),
        "state_age_s": Range(0.02, 1.0),
    },
    "HandSettings": {
        "speed_m_s": Range(0.005, 0.1),  # a slower command's deadline would be minutes away
        "grip_force_N": up_to(40),  # the hand's own limit is 70
        "hysteresis_m": Range(0, 0.02),
        "reading_age_s": Range(0.05, 1.0),
    },
    "Gains": {
        "stiffness_N_m": (Range(0, 3000),) * 3,
        "rotation_Nm_rad": (Range(0, 300),) * 3,
        "clip_m": (Range(0, 0.05),) * 3,
        "clip_rad": Range(0, 0.5),
    },
    "UniforceFrankaConfig": {
        "fps": Range(5, 100),
        "connect_deadline_s": up_to(60),
        "reflex_torque_Nm": up_to(100),
        "reflex_force_N": up_to(100),
        "open_width_m": Range(0.01, 0.08),
        "load_kg": Range(0, 3),  # the arm's own limit
    },
}


def require_in_limits(settings: object) -> None:
    """Check each number of a settings object, tuples number by number, against ``HARD_LIMITS``.

    Raises ContractError: not a finite number, or outside; names field, value and range.
    """
    name = type(settings).__name__
    for field, allowed in HARD_LIMITS[name].items():
        what = f"{name}.{field}"
        value = getattr(settings, field)
        if isinstance(allowed, Range):
            _require(what, value, allowed)
            continue
        if not isinstance(value, tuple | list) or len(value) != len(allowed):
            raise ContractError(
                expected(what, f"{len(allowed)} numbers", repr(value), "Mend the setting.")
            )
        for index, (one, row) in enumerate(zip(value, allowed, strict=True)):
            _require(f"{what}[{index}]", one, row)


def require_kind(what: str, value: object, kind: type) -> None:
    """Check that settings are of exactly this class: a subclass may check nothing when it is made.

    Raises ContractError: anything else.
    """
    if type(value) is not kind:
        raise ContractError(expected(what, kind.__name__, repr(value), "Give one."))


def _require(what: str, value: object, allowed: Range) -> None:
    if not allowed.holds(value):
        raise ContractError(
            expected(what, f"one number, {allowed}", repr(value), "Mend the setting.")
        )


@dataclass(frozen=True)
class StreamSettings:
    """Rhythm of the stream; hard limits in ``limits.HARD_LIMITS``."""

    rate_hz: float = 100.0  # targets per second
    # how long a ramp to a new action takes; the policy's own period
    action_period_s: float = 1 / 30
    stale_s: float = 0.2  # an action older than this is no longer followed
    # an older reading is not used; a robot whose clock stands still for so long is gone
    state_age_s: float = 0.2

    def __post_init__(self) -> None:
        require_in_limits(self)


@dataclass(frozen=True)
class HandSettings(HandRules):
    """``HandRules`` within the hard limits of ``limits.HARD_LIMITS``."""

    def __post_init__(self) -> None:
        require_in_limits(self)
