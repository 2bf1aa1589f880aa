"""Maps to other sensors' latents; refused where they don't belong."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from safetensors.torch import save_file

from benchmarks import sensor_transfer
from benchmarks.sensor_transfer import draw_latents
from benchmarks.transfer_fit import (
    GraspLatents,
    OtherFinger,
    SensorTransferFit,
    _shared,
    agreed_directions,
    fit_transfer,
)
from uniforce_vtla.contact import TactileSimulator
from uniforce_vtla.contact.indenters import flat_face_gap
from uniforce_vtla.contact.sampling import ForceRange
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.latent import MOST_DIRECTIONS, pool_latent
from uniforce_vtla.tokenizer.pair_cache import shrink
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer
from uniforce_vtla.tokenizer.weights import ASSETS

HASH = "abc"
NUMBERS = 24  # of a latent, in tests of directions
NOISE = 0.05
SMALL = TokenizerConfig(side=64, patch=8, width=16, depth=1, decoder_depth=1, heads=2, embed_hidden=0)


def two_sensors(n: int = 3000) -> tuple[dict[str, GraspLatents], np.ndarray]:
    """``b`` is a mixture of ``a``, moved, with noise of its own; all grasps have one amplitude."""
    rng = np.random.default_rng(0)
    mixture = np.eye(8) + 0.3 * rng.standard_normal((8, 8))
    a = rng.choice([-1.0, 1.0], (n, 4, 2)) * (1.0, 3.0) + 5
    b = (a.reshape(n, 8) @ mixture.T + 0.7).reshape(n, 4, 2)
    drawn = [x + NOISE * rng.standard_normal(x.shape) for x in (a, a, b, b)]
    rest = np.full((4, 2), 5.0)
    return {"a": GraspLatents(drawn[0], drawn[1], rest), "b": GraspLatents(drawn[2], drawn[3], rest)}, mixture


def test_a_linear_difference_and_its_noise_are_found() -> None:
    latents, mixture = two_sensors()
    transfer, facts = fit_transfer(latents, HASH, SensorTransferFit(ridge=1e-3))
    matrix, noise = transfer.matrix[0], transfer.noise_scale[0]
    assert np.allclose(matrix[1].numpy(), mixture, atol=0.03)
    a, b = (torch.from_numpy(latents[kind].first).float().flatten(1) for kind in "ab")
    assert float((transfer.mapped(a, 0, 1, noise=0.0) - b).abs().max()) < 10 * NOISE
    left = (noise[1] @ noise[1].T).diagonal().sqrt()  # noise of both ends
    wanted = NOISE * np.sqrt(1 + np.square(mixture).sum(axis=1))
    assert np.allclose(left.numpy(), wanted, rtol=0.2)
    assert facts["differences"]["a->b"]["rms_left"] < 0.2 * facts["differences"]["a->b"]["rms"]


def test_saved_equals_loaded_and_strange_files_are_refused(tmp_path: Path) -> None:
    transfer, facts = fit_transfer(two_sensors(400)[0], HASH, SensorTransferFit())
    folder = transfer.save(tmp_path / "transfer", facts)
    again = SensorTransfer.from_pretrained(tmp_path, HASH)
    with pytest.raises(CheckpointError, match="tokenizer of the maps"):
        SensorTransfer.from_pretrained(tmp_path, "another")
    assert again.kinds == ("a", "b") and again.tokenizer_hash == HASH
    assert all(torch.equal(value, transfer.state_dict()[name]) for name, value in again.state_dict().items())
    assert again.row("b") == 1
    with pytest.raises(ContractError, match=r"sensor_transfer=0"):
        again.row("c")
    with pytest.raises(CheckpointError, match="checkpoint"):
        SensorTransfer.from_pretrained(tmp_path / "nowhere", HASH)
    drop_hashes(folder)
    config = json.loads((folder / "config.json").read_text())
    for key, wrong in (("kinds", ["a"] * 99), ("numbers", 10**9), ("numbers", 9), ("numbers", np.inf), ("kinds", None)):
        (folder / "config.json").write_text(json.dumps(config | {key: wrong}))
        with pytest.raises(CheckpointError):
            SensorTransfer.from_pretrained(tmp_path, HASH)


def test_files_of_earlier_versions_still_load(tmp_path: Path) -> None:
    transfer, facts = fit_transfer(two_sensors(400)[0], HASH, SensorTransferFit())
    folder = transfer.save(tmp_path / "transfer", facts)
    earlier = {name.replace("noise_scale", "doubt"): value for name, value in transfer.state_dict().items()}
    save_file(earlier, folder / "model.safetensors")
    drop_hashes(folder)
    again = SensorTransfer.from_pretrained(tmp_path, HASH)
    assert torch.equal(again.noise_scale, transfer.noise_scale)


def test_noise_grows_with_the_amplitude_and_is_none_in_free_air() -> None:
    transfer = fit_transfer(two_sensors(600)[0], HASH, SensorTransferFit())[0]
    rest = transfer.rest[0]
    spread = {}
    for amplitude in (0.0, 1.0, 2.0, 9.0):
        z = rest + amplitude * transfer.unit[0]
        spread[amplitude] = float(transfer.mapped(z.expand(4000, -1), 0, 1).std(dim=0).mean())
    assert spread[0.0] < 1e-5 and 1.9 < spread[2.0] / spread[1.0] < 2.1
    assert 0.95 < spread[9.0] / spread[2.0] < 1.05  # bounded


def test_fingers_share_grip_and_pull_but_neither_side_force_nor_torsion() -> None:
    rng = np.random.default_rng(0)
    bounds = ForceRange(flat_torsion_arm_mm=9)
    force = np.tile(np.array([[1.0, -4.0, 9.0]], np.float32), (4000, 1))
    torsion = np.full(4000, 20.0, np.float32)
    other, own = _shared(rng, force, torsion, bounds, OtherFinger())
    assert np.array_equal(other[:, 1:], force[:, 1:])
    widest = np.sqrt((bounds.friction * 9) ** 2 - 4.0**2)
    assert abs(other[:, 0].mean()) < 0.1 * widest and 0.98 < np.abs(other[:, 0]).max() / widest <= 1
    assert abs(own.mean()) < 3 and np.abs(own).max() <= bounds.friction * 9 * 9
    same, twist = _shared(rng, force, torsion, bounds, OtherFinger(own_side=False, own_torsion=False))
    assert np.array_equal(same, force) and np.array_equal(twist, torsion)


def test_a_grasp_has_alike_latents_on_fingers_of_a_sensor_and_others_on_another() -> None:
    tokenizer = Tokenizer.from_pretrained("nano")
    config = SensorTransferFit(grasps=64, other=OtherFinger(own_side=False, own_torsion=False))
    latents = draw_latents(tokenizer, ["gelsight", "uskin"], config)
    one, other = latents["gelsight"], latents["uskin"]
    assert one.first.shape == other.second.shape == (64, 16, 6) and one.rest.shape == (16, 6)
    assert np.abs(one.first - one.second).mean() < 0.8 * np.abs(one.first - other.first).mean()
    twisted = draw_latents(tokenizer, ["gelsight"], SensorTransferFit(grasps=64))["gelsight"]
    assert np.abs(twisted.first - twisted.second).mean() > 1.5 * np.abs(one.first - one.second).mean()
    again = draw_latents(tokenizer, ["gelsight", "uskin"], config)
    assert np.array_equal(again["uskin"].second, other.second)


def test_the_command_leaves_maps_a_policy_finds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tokenizer = Tokenizer.random(SMALL)
    path = tokenizer.save(tmp_path / "tokenizer")
    given = [f"tokenizer={path}", "sensors=gelsight, tactip", "fit.grasps=128"]
    assert sensor_transfer.main(given) == 0
    assert "gelsight->tactip: differ by" in capsys.readouterr().out
    transfer = SensorTransfer.from_pretrained(path, tokenizer.hash)
    assert transfer.kinds == ("gelsight", "tactip")
    assert sensor_transfer.main([f"tokenizer={path}", "sensors=gelsite"]) == 2


@pytest.mark.parametrize("size", ["small"])
def test_shipped_maps_belong_to_the_shipped_tokenizer_and_bring_fingers_closer(size: str) -> None:
    SensorTransfer.from_pretrained(size, Tokenizer.from_pretrained(size).hash)
    folder = ASSETS / size / "transfer"
    differences = json.loads((folder / "config.json").read_text())["differences"]
    assert all(0.3 < pair["rms_left"] < 0.9 * pair["rms"] < 0.9 for pair in differences.values())


@pytest.mark.parametrize("sensor", ["gelsight", "tactip", "uskin"])
def test_four_shipped_directions_hold_pull_and_grip_and_no_side_force(sensor: str) -> None:
    """A turned eraser wedges its pads apart sideways: to read that is to take the other finger for another grasp."""
    tokenizer = Tokenizer.from_pretrained("small")
    transfer = SensorTransfer.from_pretrained("small", tokenizer.hash)
    simulator = TactileSimulator(sensor, seed=1)
    force = np.array([[0, -3, 9], [2.5, -3, 9], [-2.5, -3, 9], [0, -0.5, 9], [0, -3, 6.5]], np.float32)
    size, square = np.tile([60.0, 44.0], (len(force), 1)), np.zeros((len(force), 2))
    gap = flat_face_gap(square, size, np.zeros(len(force)), square)
    twist = np.zeros(len(force), np.float32)
    images = simulator.marker_images(ContactState(gap.astype(np.float32), force, twist))
    side = tokenizer.config.side
    reference = shrink(simulator.reference()[None], side)[0]
    latent = pool_latent(tokenizer.encode(reference, shrink(images, side)), 4).flatten(1)
    read = (latent @ transfer.directions[:, :4]).numpy()
    right, left, pull, grip = np.linalg.norm(read[1:] - read[0], axis=1)
    assert max(right, left) < 0.5 * min(pull, grip)


def fingers(seed: int, own_share: float) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Return shared force (N, 2), two fingers' latents that encode it the same way, own directions (n, 3).

    Each finger adds ``own_share`` times three numbers of its own along directions the fingers don't share force in.
    """
    rng = np.random.default_rng(seed)
    force = rng.standard_normal((1500, 2))
    basis = np.linalg.qr(rng.standard_normal((NUMBERS, 5)))[0]
    latents = []
    for _ in range(2):
        own = own_share * rng.standard_normal((len(force), 3))
        noise = 0.01 * rng.standard_normal((len(force), NUMBERS))
        latents.append(force @ basis[:, :2].T + own @ basis[:, 2:].T + noise)
    return force, latents, basis[:, 2:]


@examples(10)
@given(seed=st.integers(0, 1000), own_share=st.floats(0.1, 5.0))
def test_two_directions_hold_the_shared_force_and_nothing_a_finger_adds(seed: int, own_share: float) -> None:
    force, latents, own = fingers(seed, own_share)
    matrix, ratios = agreed_directions(latents)
    assert matrix.shape == (NUMBERS, MOST_DIRECTIONS)
    assert ratios[:2].min() > 50 > 5 > ratios[2:].max()  # two numbers are shared
    design = np.c_[latents[0] @ matrix[:, :2], np.ones(len(force))]
    left = force - design @ np.linalg.lstsq(design, force, rcond=None)[0]
    assert left.std() < 0.1
    assert np.abs(own.T @ matrix[:, :2]).max() * own_share < 0.1


def test_directions_have_spread_one_over_grasps_and_know_how_much_fingers_differ() -> None:
    _, latents, _ = fingers(2, 1.0)
    matrix, ratios = agreed_directions(latents)
    seen = np.stack([finger @ matrix for finger in latents])
    assert np.allclose(seen.mean(axis=0).std(axis=0, ddof=1), 1.0)
    own = seen - seen.mean(axis=0)
    within = np.sqrt(np.square(own).sum(axis=(0, 1)) / (own.shape[1] * (own.shape[0] - 1)))
    assert np.allclose(within, 1 / np.sqrt(ratios))


def test_a_number_that_never_moves_is_not_taken_for_agreement() -> None:
    _, latents, _ = fingers(1, 1.0)
    matrix, _ = agreed_directions([np.c_[finger, np.full(len(finger), 3.0)] for finger in latents])
    assert np.isfinite(matrix).all() and np.abs(matrix[-1, :2]).max() < 1e-6
