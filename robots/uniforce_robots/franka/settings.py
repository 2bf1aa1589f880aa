"""Settings of the stream of targets and of the hand; hard limits in ``limits.HARD_LIMITS``."""

from dataclasses import dataclass

from uniforce_robots.franka.limits import require_in_limits


@dataclass(frozen=True)
class StreamSettings:
    """Rhythm of the stream; hard limits in ``limits.HARD_LIMITS``."""

    rate_hz: float = 100.0  # targets per second
    action_period_s: float = 1 / 30  # how long a ramp to a new action takes; the policy's own period
    stale_s: float = 0.2  # an action older than this is no longer followed
    state_age_s: float = 0.2  # an older reading is not used; a robot whose clock stands still for so long is gone

    def __post_init__(self) -> None:
        require_in_limits(self)


@dataclass(frozen=True)
class HandSettings:
    """How widths become commands; hard limits in ``limits.HARD_LIMITS``."""

    speed_m_s: float = 0.05  # of the fingers
    # of a grasp; gels and domes are rated for about 11 N; the real hand's smallest force is unverified
    grip_force_N: float = 10.0
    grasp_below_m: float = 0.04  # a closing target below this is a grasp (force-bound), above it a move (position)
    hysteresis_m: float = 0.003  # a smaller change of the target is no new command
    reading_age_s: float = 0.5  # an older reading stops the arm; the hand gives about ten a second

    def __post_init__(self) -> None:
        require_in_limits(self)
