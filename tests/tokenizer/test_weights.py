from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from benchmarks.probes.labelled_set import FROZEN, HEAD_TRAINING, SENSORS, draw_labelled
from benchmarks.probes.zero_shot import encode_set, predict, score, shipped_cell
from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.tokenizer import Latent, Tokenizer
from uniforce_vtla.tokenizer.force_head import (
    ForceHead,
    ForceRegressor,
    HeadConfig,
    HeadTrainingConfig,
    train_head,
)
from uniforce_vtla.tokenizer.weights import ASSETS, SIZES


@pytest.fixture
def saved(tmp_path, tiny):
    """A checkpoint without hashes: they would refuse whatever a test does to it."""
    folder = Tokenizer.random(tiny, seed=1).save(tmp_path / "checkpoint")
    drop_hashes(folder)
    return folder


def rewrite(folder, change):
    tensors = load_file(folder / "model.safetensors")
    change(tensors)
    save_file(tensors, folder / "model.safetensors")


def test_round_trip_keeps_weights_and_hash(saved, tiny):
    original, loaded = Tokenizer.random(tiny, seed=1), Tokenizer.from_pretrained(saved)
    assert loaded.hash == original.hash and loaded.config == tiny
    pairs = zip(original.model.parameters(), loaded.model.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)


def test_truncated_weights_raise(saved):
    path = saved / "model.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match="readable weights"):
        Tokenizer.from_pretrained(saved)


def test_every_wrong_tensor_is_listed(saved):
    def spoil(tensors):
        del tensors["decoder.inject.bias"]
        tensors["extra"] = torch.zeros(1)
        tensors["decoder.inject.weight"] = torch.zeros(2, 2)

    rewrite(saved, spoil)
    with pytest.raises(CheckpointError) as error:
        Tokenizer.from_pretrained(saved)
    for line in (
        "missing decoder.inject.bias",
        "unexpected extra",
        "decoder.inject.weight is (2, 2)",
    ):
        assert line in str(error.value)


def test_a_number_that_is_not_finite_is_named(saved):
    def spoil(tensors):
        tensors["decoder.inject.bias"][0] = torch.inf
        tensors["decoder.inject.weight"][0, 0] = torch.nan

    rewrite(saved, spoil)
    with pytest.raises(
        CheckpointError, match=r"NaN or inf in decoder.inject.bias; .*decoder.inject.weight"
    ):
        Tokenizer.from_pretrained(saved)


def test_missing_folder_and_broken_config_raise(saved, tmp_path):
    with pytest.raises(CheckpointError, match="none"):
        Tokenizer.from_pretrained(tmp_path / "nothing")
    (saved / "config.json").write_text("{")
    with pytest.raises(CheckpointError, match="JSON"):
        Tokenizer.from_pretrained(saved)
    (saved / "config.json").write_text("{}")
    with pytest.raises(CheckpointError, match="TokenizerConfig"):
        Tokenizer.from_pretrained(saved)


def test_hash_follows_weights_config_and_scales(tiny):
    tokenizer = Tokenizer.random(tiny, seed=1)
    assert tokenizer.hash == Tokenizer.random(tiny, seed=1).hash
    assert tokenizer.hash != Tokenizer.random(tiny, seed=2).hash
    other = Tokenizer(
        tokenizer.model, tokenizer.canonicalizer | {"taxel_scales": {"version": "other"}}
    )
    assert tokenizer.hash != other.hash
    with torch.no_grad():
        tokenizer.model.decoder.inject.bias[0] += 1e-3
    assert tokenizer.hash != Tokenizer(tokenizer.model).hash


def test_force_head_round_trip_and_missing_source(tmp_path):
    head = ForceHead(ForceRegressor(HeadConfig()), "tactip", "abc")
    loaded = ForceHead.from_pretrained(path=head.save(tmp_path / "head"))
    z = Latent.of(torch.randn(2, 64, 6), "abc")
    assert loaded.source == "tactip" and loaded.tokenizer_hash == "abc"
    torch.testing.assert_close(loaded(z), head(z))
    with pytest.raises(CheckpointError):
        ForceHead.from_pretrained("unheard-of")
    assert read_object(tmp_path / "head" / "provenance.json", CheckpointError).keys() >= {
        "device",
        "commit",
        "dirty",
    }
    assert ForceHead.from_pretrained("tactip", tmp_path / "head").source == "tactip"
    with pytest.raises(CheckpointError, match="expected gelsight, got tactip"):
        ForceHead.from_pretrained("gelsight", tmp_path / "head")


@pytest.fixture(scope="module")
def tokenizer():
    torch.set_num_threads(1)
    return Tokenizer.from_pretrained()


def test_assets_are_small():
    assert sum(file.stat().st_size for file in ASSETS.rglob("*") if file.is_file()) <= 12e6


@pytest.mark.parametrize("size", SIZES)
def test_heads_belong_to_their_tokenizer(size):
    tokenizer = Tokenizer.from_pretrained(size)
    for sensor in SENSORS:
        head = ForceHead.from_pretrained(sensor, size)
        assert head.source == sensor and head.tokenizer_hash == tokenizer.hash


def test_shipped_head_reads_another_sensor_and_beats_an_untrained_encoder(tokenizer):
    recipe = replace(FROZEN, sequences=16, length=6, seed=11)
    target = draw_labelled(recipe, "gelsight", tokenizer.config.side)
    trained = shipped_cell(ForceHead.from_pretrained("tactip"), tokenizer, target)
    untrained = Tokenizer.random(tokenizer.config)
    source = draw_labelled(
        replace(HEAD_TRAINING, sequences=24, length=6), "tactip", tokenizer.config.side
    )
    head = train_head(
        encode_set(untrained, source), source.force_N, HeadTrainingConfig(steps=60), seed=0
    )
    baseline = score(target.force_N, predict(head, encode_set(untrained, target)))
    assert np.mean(trained["r2"]) > np.mean(baseline["r2"]) + 0.1
    assert trained["r2"][2] > 0.3


FROZEN_HASHES = {
    "small": "dd01b5d6958d2f6f6a4fd28b1ea3e466941333613029f481c81589a855c9f816",
    "nano": "042608e51cc8c3edefc09e8fe0ffcc9663e6b3c0228e85c724af5074ae363edd",
}


@pytest.mark.parametrize("size", FROZEN_HASHES)
def test_the_shipped_tokenizers_are_the_frozen_ones(size):
    """Policies, heads, views, calibrations and every published figure depend on these weights."""
    assert Tokenizer.from_pretrained(size).hash == FROZEN_HASHES[size]
