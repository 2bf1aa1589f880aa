"""The hidden pull and the uneven board of level ``touch``."""

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import run_script
from lerobot_env_uniforce_wiping.expert import Contact
from lerobot_env_uniforce_wiping.hidden import BOARD_HALF_m, PullSettings, UnevenBoard, UnevenSettings, hand_pull
from uniforce_vtla.contracts import Finger


def test_the_pull_has_its_spread_its_pace_and_its_bound() -> None:
    pulls = np.stack([hand_pull(seed, PullSettings(), 900, 30.0) for seed in range(40)])  # (40, 900, 3)
    assert pulls.std() == pytest.approx(3.0 * 0.88, rel=0.1)  # clipping at two sd takes an eighth
    assert np.abs(pulls).max() == pytest.approx(6.0)
    assert np.abs(np.diff(pulls, axis=1)).max() < 0.8, "no jump within a step"
    later = pulls[:, 48:].ravel(), pulls[:, :-48].ravel()  # 1.6 s apart: exp(-1.6² / 4·0.8²) = 0.37
    assert np.corrcoef(*later)[0, 1] == pytest.approx(0.37, abs=0.12)


def test_the_board_has_its_spread_and_its_length() -> None:
    boards = [UnevenBoard(seed, UnevenSettings()) for seed in range(60)]
    here = np.array([b.height_m(np.zeros(2)) for b in boards])
    beside = np.array([b.height_m(np.array([0.0, 0.03])) for b in boards])
    assert here.std() == pytest.approx(0.0007 * 0.88, rel=0.25)
    assert np.corrcoef(here, beside)[0, 1] == pytest.approx(0.61, abs=0.25)  # exp(-1/2)
    assert boards[0].height_m(np.array([1.0, 0.0])) == boards[0].height_m(np.array([BOARD_HALF_m[0], 0.0]))


class Frozen(WipeExpert):
    """An expert whose reading stays as it was half a second after the wipe began."""

    def reset(self, env: WipeEnv) -> None:
        super().reset(env)
        self._wiped, self._kept = 0, Contact(0.0, 0.0)

    def _estimate(self, wrench: dict[Finger, np.ndarray]) -> Contact:
        self._wiped += self.phase == "wipe"
        if self._wiped < 15:
            self._kept = super()._estimate(wrench)
        return self._kept


@pytest.mark.slow
def test_touch_that_stops_changing_does_not_wipe_this_board() -> None:
    """On ``paper`` a reading frozen half a second into the wipe was enough in two scenes of three."""
    env = WipeEnv(level="touch")
    assert sum(run_script(env, WipeExpert(), seed).clean for seed in range(5)) >= 4
    assert sum(run_script(env, Frozen(), seed).clean for seed in range(5)) <= 1
