"""Compare the grip that two fingers read: both carry the same force, so a difference is an error.

A softer or duller pad looks like another touch, which its own latents can't show. The other finger
can. It takes seconds: a flat gel covered by a tool shows the grip only once the tool presses.
"""

import math

from uniforce_vtla.tokenizer.newtons import GRIPPED_N

EVERY = 6  # control steps between two comparisons: the other finger's image must be encoded
# comparisons, ten seconds at 30 Hz; after five seconds a flat gel still reads a third of the grip
LOOKS = 50
USUAL = 1.05  # watched finger's grip over the other's, in clean wipes of 50 demonstrations
# of the ratio's logarithm around USUAL; clean wipes spread by .09 (GelSight), .06 (uSkin)
LIMIT = 0.25


class FingerBalance:
    """Compare the grip that two fingers read over the first seconds of a grasp."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._own_N = 0.0
        self._other_N = 0.0
        self._seen = 0

    @property
    def done(self) -> bool:
        """Whether this episode was judged."""
        return self._seen >= LOOKS

    def see(self, own_N: float, other_N: float) -> float | None:
        """Add both fingers' grip; return own over other grip once, after the last comparison.

        The other's grip counts as at least 0.01 N, so that a dead finger gives a number too.
        """
        if self.done or own_N < GRIPPED_N:
            return None
        self._own_N += own_N
        self._other_N += other_N
        self._seen += 1
        if not self.done:
            return None
        return self._own_N / max(self._other_N, 0.01)


def imbalance(times: float) -> float:
    """Return a ratio's distance from the usual one over its limit; above 1 a finger is wrong."""
    return abs(math.log(times / USUAL)) / LIMIT
