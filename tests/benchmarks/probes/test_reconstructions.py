from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.probes.reconstructions import (
    BRANCHES,
    ReconstructionConfig,
    Rig,
    branch_name,
    by_cross_error,
    draw_rigs,
    full_size,
    image_errors,
    marker_error,
    reconstruct,
    reconstruction_report,
    rig_report,
    summarise,
)
from uniforce_vtla.contact.indenters import UNSEEN
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import TokenizerConfig
from uniforce_vtla.tokenizer.pair_cache import shrink

SMALL = ReconstructionConfig(rigs=(("gelsight", "tactip"),), pairs=4, pairs_per_unit=2)


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return pairs whose decoder is untrained: with ``predict_change`` it draws the reference."""
    tokenizer = Tokenizer.random(TokenizerConfig(side=128, width=16, depth=1, heads=2, embed_hidden=0))
    tokenizer.model.decoder.draw[1].bias.zero_()
    (sensors, pairs), *_ = draw_rigs(SMALL)
    return reconstruct(tokenizer, sensors, pairs)


def grid(shift: tuple[int, int] = (0, 0), side: int = 12) -> np.ndarray:
    image = np.zeros((480, 640), np.uint8)
    for row in range(60, 440, 60):
        for column in range(60, 600, 60):
            y, x = row + shift[1], column + shift[0]
            image[y : y + side, x : x + side] = 255
    return image


def test_pairs_are_unseen_full_size_and_fixed_by_the_seed() -> None:
    first, again, other = (draw_rigs(c)[0][1] for c in (SMALL, SMALL, replace(SMALL, seed=1)))
    assert first.left_current.shape == (4, 480, 640) and set(first.indenters) <= set(UNSEEN)
    np.testing.assert_array_equal(first.right_current, again.right_current)
    assert not np.array_equal(first.force_N, other.force_N)


def test_marker_error_is_the_shift() -> None:
    found = marker_error(grid((3, 4)), grid())
    assert found["distance_px"] == pytest.approx(5)
    assert found["missed"] == found["spurious"] == 0 and found["matched"] == found["markers"] == 63


def test_lost_and_false_markers_are_counted_not_dropped() -> None:
    said = grid()
    said[:, :200] = 0
    said[10:20, 300:310] = 255
    found = marker_error(said, grid())
    assert found["missed"] == 21 and found["spurious"] == 1 and found["distance_px"] == 0
    nothing = marker_error(np.zeros_like(said), grid())
    assert nothing["missed"] == 63 and np.isnan(nothing["distance_px"])


def test_a_motion_beyond_half_the_pitch_counts_as_missed() -> None:
    said = grid()
    said[60:72, 60:72] = 0
    said[95:107, 60:72] = 255  # 35 px down; the pitch is 60
    found = marker_error(said, grid())
    assert found["missed"] == 1 and found["distance_px"] == 0


def test_truth_without_markers_is_refused() -> None:
    with pytest.raises(ContractError, match="two markers"):
        marker_error(grid(), np.zeros((480, 640), np.uint8))


@pytest.mark.parametrize("shift", [(0, 0), (3, -2)])
def test_a_shrunk_image_comes_back_where_it_was(shift: tuple[int, int]) -> None:
    small = shrink(grid(shift)[None], 128)[0].astype(np.float32) / 255
    found = marker_error(full_size(small, 0.5), grid(shift))
    assert found["missed"] == found["spurious"] == 0 and found["distance_px"] < 1


def test_every_branch_is_held_against_what_its_own_target_saw(rig: Rig) -> None:
    for source, target in BRANCHES:
        np.testing.assert_allclose(rig.drawn[branch_name(source, target)], rig.reference[target], atol=1e-6)
    report = rig_report(rig, SMALL)
    assert report["branches"]["L->R"]["l1"] == pytest.approx(report["copy"]["R"]["l1"], abs=1e-6)
    assert report["branches"]["R->L"]["marker_px"] == pytest.approx(report["copy"]["L"]["marker_px"])
    assert report["copy"]["L"]["marker_px"] > 3 * report["finder"]["L"]["marker_px"]
    assert report["finder"]["R"]["missed_share"] < 0.03 and report["finder"]["R"]["l1"] == 0
    assert report["cross_over_self"]["R"]["l1"] == pytest.approx(1)


def test_a_better_picture_scores_better(rig: Rig) -> None:
    halfway = (rig.reference["L"] + rig.current["L"]) / 2
    bad, better = (summarise(image_errors(x, rig, "L", SMALL)) for x in (rig.reference["L"], halfway))
    assert better["l1"] < 0.6 * bad["l1"] and better["perceptual"] < 0.6 * bad["perceptual"]


def test_means_weigh_markers_not_images() -> None:
    errors = {
        "l1": np.array([0.1, 0.3]),
        "perceptual": np.array([0.0, 0.2]),
        "distance_px": np.array([1.0, np.nan]),
        "matched": np.array([3.0, 0.0]),
        "missed": np.array([1.0, 4.0]),
        "spurious": np.array([0.0, 2.0]),
        "markers": np.array([4.0, 4.0]),
    }
    found = summarise(errors)
    assert found["marker_px"] == 1 and found["missed_share"] == 5 / 8 and found["spurious_share"] == 0.25
    assert summarise(errors | {"matched": np.zeros(2)})["marker_px"] is None


def test_the_worst_pair_is_the_one_whose_cross_branches_are_worst(rig: Rig) -> None:
    drawn = {name: images.copy() for name, images in rig.drawn.items()}
    drawn["L->R"][2] = 1 - rig.current["R"][2]
    drawn["L->L"][1] = 1 - rig.current["L"][1]  # a bad self branch doesn't count
    assert by_cross_error(replace(rig, drawn=drawn))[0] == 2
    report = rig_report(replace(rig, drawn=drawn), SMALL)
    assert report["worst"][0]["pair"] == 2


def test_hard_pairs_hold_the_unseen_gel_and_say_how_much_worse_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("benchmarks.probes.hard_sets.HARD_PAIRS_COUNT", 3)
    tokenizer = Tokenizer.random(TokenizerConfig(side=128, width=16, depth=1, heads=2, embed_hidden=0))
    content, shown = reconstruction_report(tokenizer, replace(SMALL, pairs=2))
    assert set(content["hard_rigs"]) == {"gelsight_d+tactip", "uskin+tactip"} and len(shown) == 1
    hard = content["hard_rigs"]["gelsight_d+tactip"]
    assert hard["pairs"] == 3 and len(hard["worst"]) == 3 and len(hard["digest"]) == 64
    assert reconstruction_report(tokenizer, replace(SMALL, pairs=2, hard=False))[0]["hard_rigs"] == {}
