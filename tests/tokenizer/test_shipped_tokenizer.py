from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.probes.labelled_set import FROZEN, HEAD_TRAINING, SENSORS, draw_labelled
from benchmarks.probes.zero_shot import encode_set, predict, score, shipped_cell
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.weights import ASSETS, SIZES


@pytest.fixture(scope="module")
def tokenizer() -> Tokenizer:
    torch.set_num_threads(1)
    return Tokenizer.from_pretrained()


def test_assets_are_small() -> None:
    assert sum(file.stat().st_size for file in ASSETS.rglob("*") if file.is_file()) <= 12e6


@pytest.mark.parametrize("size", SIZES)
def test_heads_belong_to_their_tokenizer(size: str) -> None:
    tokenizer = Tokenizer.from_pretrained(size)
    for sensor in SENSORS:
        head = ForceHead.from_pretrained(sensor, size)
        assert head.source == sensor and head.tokenizer_hash == tokenizer.hash


def test_shipped_head_reads_another_sensor_and_beats_an_untrained_encoder(tokenizer: Tokenizer) -> None:
    recipe = replace(FROZEN, sequences=16, length=6, seed=11)
    target = draw_labelled(recipe, "gelsight", tokenizer.config.side)
    trained = shipped_cell(ForceHead.from_pretrained("tactip"), tokenizer, target)
    untrained = Tokenizer.random(tokenizer.config)
    source = draw_labelled(replace(HEAD_TRAINING, sequences=24, length=6), "tactip", tokenizer.config.side)
    head = train_head(encode_set(untrained, source), source.force_N, HeadTrainingConfig(steps=60), seed=0)
    baseline = score(target.force_N, predict(head, encode_set(untrained, target)))
    assert np.mean(trained["r2"]) > np.mean(baseline["r2"]) + 0.1
    assert trained["r2"][2] > 0.3
