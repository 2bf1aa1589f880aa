"""Label-free calibration: from equal forces alone, and only from those."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer.calibration import Calibration, LatentAdapter, calibrate
from uniforce_vtla.tokenizer.latent import Latent
from uniforce_vtla.tokenizer.settings import CalibrationConfig

QUICK = CalibrationConfig(steps=300)


def grasps(n: int = 200) -> tuple[Latent, Latent]:
    """A new sensor that answers with two thirds of the anchor's latent, bent, and an offset."""
    torch.manual_seed(0)
    anchor = torch.randn(n, 1, 6) * torch.linspace(0.2, 1, 16)[None, :, None]
    return Latent.of(0.66 * anchor + 0.1 * torch.tanh(anchor) + 0.05, "abc"), Latent.of(anchor, "abc")


def test_adapter_starts_as_the_identity() -> None:
    z = torch.randn(3, 16, 6)
    assert torch.equal(LatentAdapter(6, 8)(z), z)


def test_calibration_restores_equilibrium_on_grasps_it_never_saw() -> None:
    new, anchor = grasps()
    found = calibrate(new, anchor, "abc", "new", "old", QUICK)
    assert found.imbalance_before > 0.05 and found.imbalance_after < 0.1 * found.imbalance_before


def test_equal_sensors_stay_as_they_are() -> None:
    _, anchor = grasps()
    found = calibrate(anchor, anchor, "abc", "new", "old", QUICK)
    assert torch.allclose(found(anchor), anchor, atol=0.02)


def test_saved_equals_loaded_and_another_tokenizer_is_refused(tmp_path: Path) -> None:
    new, anchor = grasps()
    found = calibrate(new, anchor, "abc", "new", "old", replace(QUICK, steps=20))
    found.save(tmp_path)
    again = Calibration.load(tmp_path, "abc")
    assert torch.equal(again(new), found(new)) and again.imbalance_after == found.imbalance_after
    with pytest.raises(CheckpointError, match="Calibrate again"):
        Calibration.load(tmp_path, "xyz")
    assert again(new).tokenizer_hash == "abc"
    with pytest.raises(CheckpointError, match="calibration of new"):
        again(Latent.of(anchor, "xyz"))
    with pytest.raises(CheckpointError, match="latents for calibration"):
        calibrate(new, anchor, "xyz", "new", "old", QUICK)


@pytest.mark.parametrize(
    ("new", "anchor", "says"),
    [
        (torch.ones(10, 16, 6), torch.ones(10, 16, 6), "at least"),
        (torch.ones(90, 16, 6), torch.ones(90, 9, 6), "twice"),
        (torch.full((90, 16, 6), torch.nan), torch.ones(90, 16, 6), "finite"),
        (torch.rand(90, 16, 6), torch.ones(90, 16, 6), "changing"),
    ],
)
def test_bad_grasps_are_refused(new: torch.Tensor, anchor: torch.Tensor, says: str) -> None:
    with pytest.raises(ContractError, match=says):
        calibrate(Latent.of(new, "abc"), Latent.of(anchor, "abc"), "abc", "new", "old", QUICK)
