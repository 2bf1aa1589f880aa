"""Every row that trains a whole network learns and never reads a target's label; speeds are compared in turns."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from transformers import ViTConfig

from benchmarks.baselines.cells import labels, pictures
from benchmarks.baselines.end_to_end import EndToEndConfig, train_end_to_end
from benchmarks.baselines.finetuned import TokenizerEncoder, finetuned_row, fit_finetuned
from benchmarks.baselines.resnet import ResNetConfig, build_resnet, fit_resnet, resnet_row
from benchmarks.baselines.speed import T3Encoder, our_size, size_facts, speed_report
from benchmarks.probes.zero_shot import Cells, Table, encode_set, score
from benchmarks.timing import in_turns
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig

SHORT = EndToEndConfig(steps=3, frames_per_step=16)
RESNET = ResNetConfig(width=8, blocks=(1, 1, 1), training=replace(SHORT, steps=80))


def short_row(name: str, table: Table, tiny: TokenizerConfig) -> Cells:
    if name == "resnet":
        return resnet_row(table, 1, replace(RESNET, training=SHORT))
    return finetuned_row(table, Tokenizer.random(tiny), 1, SHORT)


@pytest.mark.parametrize("name", ["resnet", "finetuned"])
def test_labels_of_targets_are_never_read(name, table, tiny, predictions) -> None:
    wrong = {s: replace(a, force_N=np.full_like(a.force_N, 99)) for s, a in table.frozen.items()}
    honest_row = short_row(name, table, tiny)
    honest = predictions()
    corrupt_row = short_row(name, replace(table, frozen=wrong), tiny)
    corrupt = predictions()
    assert len(honest) == len(corrupt) >= 2
    for a, b in zip(honest, corrupt, strict=True):
        np.testing.assert_array_equal(a, b)
    assert honest_row != corrupt_row  # the scores did see the change
    assert {"G->T", "T->G"} <= set(honest_row)


def test_resnet_learns_its_own_sensor(table: Table) -> None:
    source, unseen = table.training["gelsight"], table.frozen["gelsight"]
    predict = fit_resnet(source, RESNET, seed=0)
    # the mean predictor is at 0
    assert min(score(unseen.force_N, predict(pictures(unseen)))["r2"]) > 0.3


def test_end_to_end_loss_falls_and_repeats(table: Table) -> None:
    shown, force = pictures(table.training["gelsight"]), labels(table.training["gelsight"])
    runs = []
    for _ in range(2):
        model = build_resnet(RESNET, 32, force, seed=3)
        runs.append(train_end_to_end(model, shown, force, replace(SHORT, steps=30), seed=3))
    assert runs[0] == runs[1]
    assert np.mean(runs[0][-5:]) < 0.8 * np.mean(runs[0][:5])


def test_fine_tuning_starts_from_the_tokenizer_and_leaves_it_alone(
    table: Table, tiny: TokenizerConfig
) -> None:
    tokenizer = Tokenizer.random(tiny)
    before = {k: v.clone() for k, v in tokenizer.model.state_dict().items()}
    encoder = TokenizerEncoder(tokenizer)
    reference, frames = pictures(table.frozen["tactip"]).tensors(slice(0, 3))
    same = encode_set(tokenizer, table.frozen["tactip"])[:3]
    torch.testing.assert_close(encoder(reference, frames), same, atol=1e-5, rtol=1e-4)
    finetuned_row(table, tokenizer, 1, SHORT)
    assert all(torch.equal(before[k], v) for k, v in tokenizer.model.state_dict().items())
    assert not any(p.requires_grad for p in tokenizer.model.parameters())


def test_fine_tuning_improves_on_the_frozen_head(table: Table, tiny: TokenizerConfig) -> None:
    source, tokenizer, unseen = (
        table.training["gelsight"],
        Tokenizer.random(tiny),
        table.frozen["gelsight"],
    )
    r2 = []
    for steps in (1, 80):
        training = EndToEndConfig(
            steps=steps, frames_per_step=32, learning_rate=1e-3, encoder_rate=1.0
        )
        predict = fit_finetuned(source, tokenizer, table.head, training, seed=0)
        r2.append(np.mean(score(unseen.force_N, predict(pictures(unseen)))["r2"]))
    assert r2[1] > r2[0] and r2[1] > 0.3


def t3(depth: int) -> T3Encoder:
    sizes = {
        "hidden_size": 96,
        "intermediate_size": 384,
        "num_attention_heads": 2,
        "num_hidden_layers": 1 + depth,
    }
    return T3Encoder(ViTConfig(image_size=64, patch_size=8, **sizes))


def test_t3_medium_has_its_published_size() -> None:
    """ViT-B/16 without a head: 85.8 M parameters, 17.6 G multiply-adds."""
    with torch.device("meta"):
        facts = size_facts(T3Encoder())
    assert facts["params"] == 85_798_656 and 34e9 < facts["flops_per_frame"] < 37e9


def test_report_is_plain_data_and_ranks_by_work(tiny: TokenizerConfig) -> None:
    encoders = {"small": t3(1), "large": t3(24)}
    report = speed_report(Tokenizer.random(tiny), encoders, rounds=3, ours_per_round=2)
    encoders = json.loads(json.dumps(report))["encoders"]
    assert set(encoders) == {"UniForce", "small", "large"}
    assert encoders["UniForce"]["times_ours"] == 1
    assert encoders["large"]["cpu_ms_per_frame"] > encoders["small"]["cpu_ms_per_frame"] > 0
    assert encoders["large"]["ms_per_frame"] > 0 and encoders["large"]["cpu_times_ours"] > 1
    assert encoders["large"]["flops_per_frame"] > 5 * encoders["small"]["flops_per_frame"]


def test_our_flops_are_those_of_the_current_frame_alone(tiny: TokenizerConfig) -> None:
    facts = our_size(Tokenizer.random(tiny))
    P, D = 16, 16
    attention = P * (4 * D * D) + 2 * P * P * D  # qkv and out; scores and mixing
    temporal = P * 4 * D * D  # its scores are elementwise products
    block = attention + temporal + P * 2 * 3 * D * D
    # pixels; motion channels: 3 × 3 scales, 2 × 2 cells
    embed = P * (64 * 16 + 16 * D) + P * (9 * 4 * D + D * D)
    posterior = P * D * 12
    assert facts["flops_per_frame"] == 2 * (2 * block + embed + posterior)
    assert facts["params"] == sum(
        p.numel() for p in Tokenizer.random(tiny).model.encoder.parameters()
    )


def test_turns_alternate_after_a_warm_up() -> None:
    order: list[str] = []

    def turn(name: str) -> int:
        order.append(name)
        return 2

    taken = in_turns({"a": lambda: turn("a"), "b": lambda: turn("b")}, 2, lambda call: call())
    assert order == ["a", "b"] * 3
    assert {name: len(times) for name, times in taken.items()} == {"a": 2, "b": 2}
