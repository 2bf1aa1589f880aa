"""Row of an episode."""

from dataclasses import dataclass

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_vtla.evaluation.episode import EpisodeResult


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


def row_of(cell: str, env: WipeEnv, result: EpisodeResult) -> Row:
    """Return what is kept of an episode."""
    return Row(
        cell,
        env.scene.seed,
        bool(result.clean),
        result.outcome,
        float(result.metrics.get("in_band_share", 0.0)),
        bool(result.slippage),
        bool(result.excess_force),
    )
