"""Row of an episode."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One episode of a cell."""

    cell: str
    seed: int
    clean: bool
    outcome: str
    in_band_share: float
    slippage: bool
    excess_force: bool
    ended_s: float = 0.0
    event_s: float | None = None  # when it first slipped, pressed too hard or lost what it held
