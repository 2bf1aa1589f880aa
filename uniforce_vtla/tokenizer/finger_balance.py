"""Whether two fingers agree on the grip: what they hold presses both alike, so where they differ one is wrong in scale.

A pad that has become softer or duller looks like another touch, and its own latents can't show it. The other finger
can. It takes seconds: a flat gel shows the grip of a tool that covers it only once the tool is pressed on something.
"""

import math

GRIPPED_N = 2.0  # less is no grip
# control steps between two looks at both fingers: the other one's picture has to be encoded for it
EVERY = 6
# that are compared: ten seconds at 30 Hz. After five, a flat gel still reads a third of the grip
LOOKS = 50
# of clean wipes with 50 demonstrations' sensors: the watched finger reads this many times the other's grip
USUAL = 1.05
# logarithm, around USUAL; clean wipes spread by .09 with a GelSight on the other finger, by .06 with a uSkin
LIMIT = 0.25


class FingerBalance:
    """Compares the grip that two fingers read over the first seconds in which something is held."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._own_N = self._other_N = 0.0
        self._seen = 0

    @property
    def done(self) -> bool:
        """Whether this episode was judged."""
        return self._seen >= LOOKS

    def see(self, own_N: float, other_N: float) -> float | None:
        """Take in both fingers' grip; return how many times the other's this finger reads, once, after the last look.

        The other's grip counts as at least a hundredth of a newton, so that a dead finger gives a number too.
        """
        if self.done or own_N < GRIPPED_N:
            return None
        self._own_N += own_N
        self._other_N += other_N
        self._seen += 1
        return self._own_N / max(self._other_N, 0.01) if self.done else None


def imbalance(times: float) -> float:
    """Return the distance of a ratio from the usual one, over its limit: above 1 one finger is wrong in scale."""
    return abs(math.log(times / USUAL)) / LIMIT
