"""What another sensor would have said: fitted where a linear map is the truth, and refused where it doesn't belong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from uniforce_vtla.commands import sensor_transfer
from uniforce_vtla.commands.sensor_transfer import draw_latents
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.transfer import SensorTransfer, TransferConfig, fit_transfer

HASH = "abc"
NOISE = 0.05
SMALL = TokenizerConfig(side=64, patch=8, width=16, depth=1, decoder_depth=1, heads=2, embed_hidden=0)


def two_sensors(n: int = 3000) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """``b`` says a mixture of what ``a`` says, moved, with noise of its own."""
    rng = np.random.default_rng(0)
    mixture = np.eye(8) + 0.3 * rng.standard_normal((8, 8))
    a = rng.standard_normal((n, 4, 2)) * (1.0, 3.0) + 5
    b = (a.reshape(n, 8) @ mixture.T + 0.7).reshape(n, 4, 2)
    told = [x + NOISE * rng.standard_normal(x.shape) for x in (a, a, b, b)]
    return {"a": (told[0], told[1]), "b": (told[2], told[3])}, mixture


def test_a_linear_difference_and_its_noise_are_found() -> None:
    latents, mixture = two_sensors()
    transfer, facts = fit_transfer(latents, HASH, TransferConfig(ridge=1e-3))
    matrix, _, doubt = transfer.of("a")
    assert np.allclose(matrix[1].numpy(), mixture, atol=0.03)
    a, b = (torch.from_numpy(latents[kind][0]).float().flatten(1) for kind in "ab")
    said = a @ transfer.matrix[0, 1].T + transfer.offset[0, 1]
    assert float((said - b).abs().max()) < 10 * NOISE
    left = (doubt[1] @ doubt[1].T).diagonal().sqrt()  # noise of both ends
    wanted = NOISE * np.sqrt(1 + np.square(mixture).sum(axis=1))
    assert np.allclose(left.numpy(), wanted, rtol=0.2)
    assert facts["differences"]["a->b"]["rms_left"] < 0.2 * facts["differences"]["a->b"]["rms"]


def test_saved_equals_loaded_and_strange_files_are_refused(tmp_path: Path) -> None:
    transfer, facts = fit_transfer(two_sensors(400)[0], HASH, TransferConfig())
    folder = transfer.save(tmp_path / "transfer", facts)
    again = SensorTransfer.from_pretrained(tmp_path)
    assert again.kinds == ("a", "b") and again.tokenizer_hash == HASH
    assert all(torch.equal(x, y) for x, y in zip(again.of("b"), transfer.of("b"), strict=True))
    with pytest.raises(ContractError, match="sensor_transfer=0"):
        again.of("c")
    with pytest.raises(CheckpointError, match="checkpoint"):
        SensorTransfer.from_pretrained(tmp_path / "nowhere")
    config = json.loads((folder / "config.json").read_text())
    for key, wrong in (("kinds", ["a"] * 99), ("numbers", 10**9), ("numbers", 9), ("kinds", None)):
        (folder / "config.json").write_text(json.dumps(config | {key: wrong}))
        with pytest.raises(CheckpointError):
            SensorTransfer.from_pretrained(tmp_path)


def test_the_same_touch_is_said_alike_by_units_of_a_sensor_and_otherwise_by_others() -> None:
    tokenizer = Tokenizer.from_pretrained("nano")
    latents = draw_latents(tokenizer, ["gelsight", "uskin"], TransferConfig(contacts=64))
    (first, second), (other, _) = latents["gelsight"], latents["uskin"]
    assert first.shape == other.shape == (64, 16, 6)
    assert np.abs(first - second).mean() < 0.8 * np.abs(first - other).mean()
    again = draw_latents(tokenizer, ["gelsight", "uskin"], TransferConfig(contacts=64))
    assert np.array_equal(again["uskin"][1], latents["uskin"][1])


def test_the_command_leaves_maps_a_policy_finds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tokenizer = Tokenizer.random(SMALL)
    path = tokenizer.save(tmp_path / "tokenizer")
    given = [f"tokenizer={path}", "sensors=gelsight, tactip", "fit.contacts=128"]
    assert sensor_transfer.main(given) == 0
    assert "gelsight->tactip: differ by" in capsys.readouterr().out
    transfer = SensorTransfer.from_pretrained(path)
    assert transfer.tokenizer_hash == tokenizer.hash and transfer.kinds == ("gelsight", "tactip")
    assert sensor_transfer.main([f"tokenizer={path}", "sensors=gelsite"]) == 2


@pytest.mark.parametrize("size", ["small"])
def test_shipped_maps_belong_to_the_shipped_tokenizer_and_bring_sensors_closer(size: str) -> None:
    transfer = SensorTransfer.from_pretrained(size)
    assert transfer.tokenizer_hash == Tokenizer.from_pretrained(size).hash
    folder = Path(sensor_transfer.__file__).parents[1] / "tokenizer" / "assets" / size / "transfer"
    told = json.loads((folder / "config.json").read_text())["differences"]
    assert all(pair["rms_left"] < 0.45 for pair in told.values())
    assert told["tactip->uskin"]["rms_left"] < 0.8 * told["tactip->uskin"]["rms"]
