"""What the hand is asked to do, and what it says."""

from dataclasses import dataclass

THINNEST_m = 0.002  # of what may be grasped; fingers closer than this hold nothing
OUTER_m = 0.08  # outer tolerance of a grasp: the tool may be thicker than the target, on purpose


@dataclass(frozen=True)
class HandCommand:
    """What to ask of the hand: a grasp where ``force_N`` > 0, a plain move where it is 0."""

    width_m: float
    speed_m_s: float
    force_N: float = 0.0

    @property
    def grasp_width_m(self) -> float:
        """Width to name in a grasp: wide enough that fingers closed on nothing lie outside the tolerance."""
        return max(self.width_m, 2 * THINNEST_m)

    @property
    def inner_m(self) -> float:
        """Inner tolerance of a grasp: anything thicker than ``THINNEST_m`` counts as held."""
        return self.grasp_width_m - THINNEST_m


@dataclass(frozen=True)
class HandReading:
    """What the hand said: opening between the fingers, whether it holds something, host clock at receipt."""

    time_s: float
    width_m: float
    max_width_m: float
    is_grasped: bool
