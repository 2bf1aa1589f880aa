import numpy as np
import pytest

from benchmarks.probes.latent_and_pictures import fit_rotation
from uniforce_vtla.errors import ContractError


def mixed(
    seed: int, gain: float = 1.0, noise: float = 0.3
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return latents (30, 4, 6), forces (30, 4, 3), and the (6, 6) basis whose first axes carry force."""
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))[0]
    rng = np.random.default_rng(seed)
    force = rng.uniform(-3, 3, (30, 4, 3))
    on_axes = np.concatenate([gain * force, rng.standard_normal((30, 4, 3))], axis=-1)
    on_axes = on_axes + noise * rng.standard_normal(on_axes.shape)
    return on_axes @ basis.T, force, basis


def abs_r(z: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Return (3,) |r| of the first three axes with their own force."""
    return np.array(
        [abs(np.corrcoef(z[..., i].ravel(), force_N[..., i].ravel())[0, 1]) for i in range(3)]
    )


def test_rotation_is_orthogonal_and_finds_the_directions_of_force_on_unseen_data() -> None:
    z, force, basis = mixed(1)
    rotation = fit_rotation(z, force)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(6), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert ((rotation[:, :3] * basis[:, :3]).sum(axis=0) > 0.98).all()
    other, truth, _ = mixed(2, gain=2.0)
    assert (abs_r(other @ rotation, truth) > 0.98).all()


def test_a_weak_force_beside_strong_ones_is_found_too() -> None:
    """Strong shear lies askew to the weak normal force: the nearest triple to the regression directions loses it."""
    rng = np.random.default_rng(3)
    force = rng.uniform(-3, 3, (60, 8, 3))
    carries = np.array(
        [[1.0, 0, 0, 0.3, 0, 0], [0, 1.0, 0, 0, 0.3, 0], [0.1, 0.1, 0.05, 0, 0, 0.01]]
    )
    z = force @ carries + 0.002 * rng.standard_normal((60, 8, 6))
    assert (abs_r(z[30:] @ fit_rotation(z[:30], force[:30]), force[30:]) > 0.9).all()


def test_rotation_fitted_to_shuffled_labels_finds_nothing() -> None:
    z, force, _ = mixed(1)
    wrong = fit_rotation(z, np.random.default_rng(0).permutation(force))
    other, truth, _ = mixed(2)
    assert abs_r(other @ wrong, truth).mean() < 0.7


@pytest.mark.parametrize(
    ("spoil", "says"), [("nan", "NaN"), ("shape", "finite"), ("flat", "three directions")]
)
def test_bad_input_raises(spoil: str, says: str) -> None:
    z, force, _ = mixed(6)
    if spoil == "nan":
        z[0, 0, 0] = np.nan
    elif spoil == "shape":
        force = force[:, :3]
    else:
        z = np.ones_like(z)
    with pytest.raises(ContractError, match=says):
        fit_rotation(z, force)
