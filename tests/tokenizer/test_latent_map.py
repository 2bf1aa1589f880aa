"""The map of a latent: the numbers it has always given."""

import numpy as np
import pytest
import torch

from uniforce_vtla.tokenizer.latent_map import fit_map


def paired_latents(rows):
    rng = np.random.default_rng(11)
    new = rng.normal(size=(rows, 2, 3)) * (1, 2, 0.5)
    anchor = 1.2 * new + 0.3 * new[:, ::-1] + 0.1 * rng.normal(size=new.shape) + (0.5, 0, -1)
    return torch.from_numpy(new).float(), torch.from_numpy(anchor).float()


@pytest.mark.parametrize(
    "rows, per_grasp, ridge, mapped",
    [
        (40, 1, 0.01, [0.425245, 3.071679, -0.357187, -0.021224, 0.100383, -1.185278]),
        (5, 1, 1e-4, [0.477633, 3.061259, -0.418661, -0.063612, 0.172423, -1.162827]),
        (12, 6, 0.1, [0.385771, 3.062835, -0.282846, 0.020323, 0.068857, -1.1791]),
        (60, 3, 0.01, [0.369355, 3.098579, -0.354905, -0.104469, 0.079542, -1.11689]),
        (8, 8, 1e-4, [0.438786, 3.01379, -0.204491, -0.026335, 0.172293, -1.098221]),  # one grasp
    ],
)
def test_the_ridge_and_the_mapped_latents_stay(rows, per_grasp, ridge, mapped):
    new, anchor = paired_latents(rows)
    grasps = np.arange(rows) // per_grasp
    found, chosen = fit_map(new, anchor, grasps)
    assert chosen == ridge
    assert found(new)[0].flatten().numpy() == pytest.approx(mapped, abs=1e-5)
