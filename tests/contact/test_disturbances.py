"""What goes wrong on purpose: creep, light, misaligned and unbalanced pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uniforce_vtla.contact.hysteresis import Creep, felt_force
from uniforce_vtla.contact.illumination import Light
from uniforce_vtla.contact.pairs import PairSettings, equilibrium_pairs

QUIET = PairSettings(unit_strength=0.0, flat_share=0.0)


@given(st.floats(0.0, 0.3), st.floats(0.2, 2.0))
def test_creep_lags_and_settles(share: float, tau: float) -> None:
    force = np.concatenate([np.zeros((5, 3)), np.ones((200, 3))]).astype(np.float32)
    felt = felt_force(force, Creep(share, tau), rate_hz=10.0)
    assert np.all(felt <= 1 + 1e-6) and np.all(np.diff(felt, axis=0) >= -1e-6)
    assert np.allclose(felt[5], 1 - share * np.exp(-1 / (tau * 10)), atol=1e-5)
    assert np.allclose(felt[-1], 1, atol=1e-3)


def test_no_late_share_is_no_creep() -> None:
    force = np.random.default_rng(0).random((12, 3)).astype(np.float32)
    assert np.allclose(felt_force(force, Creep(0.0, 1.0), 10.0), force)


def test_light_scales_channels_and_leans_to_one_side() -> None:
    frames = np.full((1, 480, 640, 3), 100, np.uint8)
    lit = Light((1.0, 0.5, 1.0), (0.2, 0.0)).on(frames)[0].astype(float)
    assert abs(lit[240, 320, 0] - 100) <= 1 and abs(lit[240, 320, 1] - 50) <= 1
    assert lit[240, -1, 0] > lit[240, 0, 0] + 30


def test_perfect_pairs_by_default_and_disturbed_ones_on_request() -> None:
    def draw(settings: PairSettings):
        return equilibrium_pairs(np.random.default_rng(5), 6, "gelsight", "tactip", settings=settings)

    plain, moved, unbalanced = (
        draw(s) for s in (QUIET, replace(QUIET, misaligned_cells=2), replace(QUIET, imbalance=0.3))
    )
    for other in (moved, unbalanced):
        assert np.array_equal(plain.left_current, other.left_current)
        assert not np.array_equal(plain.right_current, other.right_current)
        assert np.array_equal(plain.force_N, other.force_N)
