import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from benchmarks.probes.labelled_set import FROZEN, HEAD_TRAINING, SENSORS, draw_labelled
from benchmarks.probes.zero_shot import encode_set, predict, score, shipped_cell
from benchmarks.trust.injuries import cut
from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.tokenizer import Tokenizer
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


def test_round_trip_keeps_weights_and_hash(saved, tiny):
    loaded = Tokenizer.from_pretrained(saved)
    # of weights, sizes and scales
    assert loaded.hash == Tokenizer.random(tiny, seed=1).hash and loaded.config == tiny


def change_tensors(folder, change):
    tensors = load_file(folder / "model.safetensors")
    change(tensors)
    save_file(tensors, folder / "model.safetensors")


def misshape(tensors):
    del tensors["decoder.inject.bias"]
    tensors["extra"] = torch.zeros(1)
    tensors["decoder.inject.weight"] = torch.zeros(2, 2)


def infinite(tensors):
    tensors["decoder.inject.bias"][0] = torch.inf
    tensors["decoder.inject.weight"][0, 0] = torch.nan


@pytest.mark.parametrize(
    "damage, says",
    [
        (lambda folder: cut(folder / "model.safetensors", 0.9), "readable weights"),
        (
            lambda folder: change_tensors(folder, misshape),
            r"missing decoder.inject.bias; unexpected extra; decoder.inject.weight is \(2, 2\)",
        ),
        (
            lambda folder: change_tensors(folder, infinite),
            r"NaN or inf in decoder.inject.bias; .*decoder.inject.weight",
        ),
        (shutil.rmtree, "none"),
        (lambda folder: (folder / "config.json").write_text("{"), "JSON"),
        (lambda folder: (folder / "config.json").write_text("{}"), "TokenizerConfig"),
    ],
)
def test_what_is_damaged_is_named(saved, damage, says):
    damage(saved)
    with pytest.raises(CheckpointError, match=says):
        Tokenizer.from_pretrained(saved)


def test_hash_follows_weights_config_and_scales(tiny):
    tokenizer = Tokenizer.random(tiny, seed=1)
    assert tokenizer.hash == Tokenizer.random(tiny, seed=1).hash
    assert tokenizer.hash != Tokenizer.random(tiny, seed=2).hash
    other = tokenizer.canonicalizer | {"taxel_scales": {"version": "other"}}
    assert tokenizer.hash != Tokenizer(tokenizer.model, other).hash
    with torch.no_grad():
        tokenizer.model.decoder.inject.bias[0] += 1e-3
    assert tokenizer.hash != Tokenizer(tokenizer.model).hash


def test_force_head_round_trip_and_missing_source(tmp_path):
    head = ForceHead(ForceRegressor(HeadConfig()), "tactip", "abc")
    folder = head.save(tmp_path / "head")
    loaded = ForceHead.from_pretrained(path=folder)
    # of weights and source
    assert loaded.hash == head.hash and loaded.tokenizer_hash == "abc"
    with pytest.raises(CheckpointError):
        ForceHead.from_pretrained("unheard-of")
    made = json.loads((folder / "provenance.json").read_text())
    assert made.keys() >= {"device", "commit", "dirty"}
    assert ForceHead.from_pretrained("tactip", folder).source == "tactip"
    with pytest.raises(CheckpointError, match="expected gelsight, got tactip"):
        ForceHead.from_pretrained("gelsight", folder)


def test_assets_are_small():
    assert sum(file.stat().st_size for file in ASSETS.rglob("*") if file.is_file()) <= 12e6


FROZEN_HASHES = {
    "small": "dd01b5d6958d2f6f6a4fd28b1ea3e466941333613029f481c81589a855c9f816",
    "nano": "042608e51cc8c3edefc09e8fe0ffcc9663e6b3c0228e85c724af5074ae363edd",
}


@pytest.mark.parametrize("size", SIZES)
def test_the_shipped_tokenizers_are_the_frozen_ones_and_have_a_head_of_each_sensor(size):
    """Policies, heads, views, calibrations and every published figure depend on these weights."""
    assert Tokenizer.from_pretrained(size).hash == FROZEN_HASHES[size]
    for sensor in SENSORS:
        head = ForceHead.from_pretrained(sensor, size)
        assert head.source == sensor and head.tokenizer_hash == FROZEN_HASHES[size]


def test_shipped_head_reads_another_sensor_and_beats_an_untrained_encoder():
    tokenizer = Tokenizer.from_pretrained()
    untrained = Tokenizer.random(tokenizer.config)
    side = tokenizer.config.side
    target = draw_labelled(replace(FROZEN, sequences=16, length=6, seed=11), "gelsight", side)
    source = draw_labelled(replace(HEAD_TRAINING, sequences=24, length=6), "tactip", side)
    trained = shipped_cell(ForceHead.from_pretrained("tactip"), tokenizer, target)
    latents = encode_set(untrained, source)
    head = train_head(latents, source.force_N, HeadTrainingConfig(steps=60), seed=0)
    baseline = score(target.force_N, predict(head, encode_set(untrained, target)))
    assert np.mean(trained["r2"]) > np.mean(baseline["r2"]) + 0.1
    assert trained["r2"][2] > 0.3
