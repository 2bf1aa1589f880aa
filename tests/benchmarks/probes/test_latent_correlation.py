from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.probes.labelled_set import FROZEN, HEAD_TRAINING, draw_labelled
from benchmarks.probes.latent_correlation import (
    assigned_axes,
    correlations,
    fit_rotation,
    indenters_of,
    latent_correlation,
    pad_latent,
    pearson,
    per_newton,
)
from uniforce_vtla.contact.indenters import UNSEEN
from uniforce_vtla.contact.sequences import force_sequences
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import TokenizerConfig

SHORT = replace(FROZEN, sequences=4, length=6)


def mixed(seed: int, gain: float = 1.0, noise: float = 0.3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return latents (30, 4, 6), forces (30, 4, 3), and the (6, 6) basis whose first axes carry force."""
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))[0]
    rng = np.random.default_rng(seed)
    force = rng.uniform(-3, 3, (30, 4, 3))
    on_axes = np.concatenate([gain * force, rng.standard_normal((30, 4, 3))], axis=-1)
    on_axes = on_axes + noise * rng.standard_normal(on_axes.shape)
    return on_axes @ basis.T, force, basis


def test_rotation_is_orthogonal_and_finds_the_directions_of_force() -> None:
    z, force, basis = mixed(1)
    rotation = fit_rotation(z, force, "here")
    np.testing.assert_allclose(rotation.matrix.T @ rotation.matrix, np.eye(6), atol=1e-9)
    assert np.linalg.det(rotation.matrix) == pytest.approx(1)
    agreement = (rotation.matrix[:, :3] * basis[:, :3]).sum(axis=0)
    assert (agreement > 0.98).all()


def test_one_rotation_serves_unseen_data_and_beats_no_rotation() -> None:
    z, force, _ = mixed(1)
    rotation, axes = fit_rotation(z, force, "here"), assigned_axes(z, force)
    other, truth, _ = mixed(2, gain=2.0)
    after, before = pearson(rotation(other), truth), pearson(other, truth)
    assert (after.diagonal() > 0.98).all()
    assert all(abs(before[axis, i]) < after[i, i] for i, axis in enumerate(axes))
    np.testing.assert_allclose(per_newton(rotation(other), truth), 2, rtol=0.05)


def test_a_faint_force_beside_loud_ones_is_found_too() -> None:
    """Loud shear lies askew to the faint normal force: the nearest triple to the regression directions loses it."""
    rng = np.random.default_rng(3)
    force = rng.uniform(-3, 3, (60, 8, 3))
    carries = np.array([[1.0, 0, 0, 0.3, 0, 0], [0, 1.0, 0, 0, 0.3, 0], [0.1, 0.1, 0.05, 0, 0, 0.01]])
    z = force @ carries + 0.002 * rng.standard_normal((60, 8, 6))
    turned = fit_rotation(z[:30], force[:30], "here")(z[30:])
    assert (np.abs(pearson(turned, force[30:]).diagonal()) > 0.9).all()


def test_rotation_fitted_to_shuffled_labels_finds_nothing() -> None:
    z, force, _ = mixed(1)
    wrong = fit_rotation(z, np.random.default_rng(0).permutation(force), "nowhere")
    other, truth, _ = mixed(2)
    assert np.abs(pearson(wrong(other), truth)).diagonal().mean() < 0.7


def test_r_is_pearsons_and_a_constant_latent_tells_nothing() -> None:
    z, force, _ = mixed(3)
    z[..., 5] = 0.25
    r = pearson(z, force)
    assert r[1, 2] == pytest.approx(np.corrcoef(z[..., 1].ravel(), force[..., 2].ravel())[0, 1])
    assert (r[5] == 0).all()


def test_indenters_are_kept_apart() -> None:
    z, force, _ = mixed(4, noise=0.0)
    names = ["cone"] * 15 + ["wave"] * 15
    z[15:] *= -1  # as if one indenter turned everything round
    found = correlations(z, force, names)
    cone, wave = (np.array(found["by_indenter"][name]) for name in ("cone", "wave"))
    np.testing.assert_allclose(np.array(found["mean"]), (cone + wave) / 2)
    assert np.abs(cone + wave).max() < 0.6 * np.abs(cone).max()
    assert found["frames"] == 120 and found["indenters"] == 2 and found["sequences"] == 30
    assert np.array(found["p_indenters"]).min() > 1e-3  # two indenters that disagree prove nothing


def test_p_falls_with_the_number_of_frames() -> None:
    z, force, _ = mixed(5)
    few, many = (correlations(z[:n], force[:n], ["cone"] * n) for n in (3, 30))
    assert few["sd"] is None and few["p_indenters"] is None
    assert np.median(many["p_frames"]) < np.median(few["p_frames"])


def test_names_belong_to_the_sequences_a_recipe_draws() -> None:
    rng = np.random.default_rng(SHORT.seed)
    batch = force_sequences(rng, "uskin", 4, 6, SHORT.indenters, SHORT.force_range)
    assert indenters_of(SHORT) == batch.indenters and set(batch.indenters) <= set(UNSEEN)


def test_whole_report_of_an_untrained_tokenizer() -> None:
    tokenizer = Tokenizer.random(TokenizerConfig(side=32, patch=8, width=16, heads=2, embed_hidden=16))
    training = draw_labelled(replace(HEAD_TRAINING, sequences=4, length=6), "uskin", 32)
    unseen = {"uskin": draw_labelled(SHORT, "uskin", 32), "another": draw_labelled(SHORT, "gelsight", 32)}
    names = dict.fromkeys(unseen, indenters_of(SHORT))
    report = latent_correlation(tokenizer, training, unseen, names, source="uskin")
    for sensor, labelled in unseen.items():
        z = pad_latent(tokenizer, labelled) @ np.array(report["rotation"])
        expected = np.abs(pearson(z, labelled.force_N)).diagonal()
        np.testing.assert_allclose(report["best_abs_r"][sensor], expected)
    assert report["after"]["axes"] == [0, 1, 2] and report["source"] == "uskin"
    with pytest.raises(ContractError, match="another"):
        latent_correlation(tokenizer, training, unseen, {"uskin": names["uskin"]}, source="uskin")


@pytest.mark.parametrize("spoil", ["nan", "shape", "constant", "names"])
def test_bad_input_raises(spoil: str) -> None:
    z, force, _ = mixed(6)
    names = ["cone"] * (29 if spoil == "names" else 30)
    if spoil == "nan":
        z[0, 0, 0] = np.nan
    elif spoil == "shape":
        force = force[:, :3]
    elif spoil == "constant":
        force[..., 1] = 0
    with pytest.raises(ContractError, match="expected"):
        correlations(z, force, names)


def test_a_collapsed_latent_cant_be_rotated() -> None:
    _, force, _ = mixed(7)
    with pytest.raises(ContractError, match="three directions"):
        fit_rotation(np.ones((30, 4, 6)), force, "here")
