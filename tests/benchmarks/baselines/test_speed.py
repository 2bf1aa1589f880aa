import json

import pytest
import torch

from benchmarks.baselines.frozen import PublishedEncoder
from benchmarks.baselines.speed import SpeedConfig, interleaved, one_thread, our_size, speed_report
from benchmarks.baselines.t3 import T3Config, T3Encoder
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.settings import TokenizerConfig


def t3(depth: int) -> PublishedEncoder:
    return T3Encoder(T3Config(image=64, patch=8, width=96, heads=2, encoder_depth=1, trunk_depth=depth))


def test_report_is_plain_data_and_ranks_by_work(tiny: TokenizerConfig) -> None:
    encoders = {"small": t3(1), "large": t3(24)}
    report = speed_report(Tokenizer.random(tiny), SpeedConfig(repeats=3, ours_per_round=2), encoders)
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
    assert facts["params"] == sum(p.numel() for p in Tokenizer.random(tiny).model.encoder.parameters())


def test_turns_alternate_after_a_warm_up() -> None:
    order: list[str] = []

    def turn(name: str) -> int:
        order.append(name)
        return 2

    taken = interleaved({"a": lambda: turn("a"), "b": lambda: turn("b")}, repeats=2)
    assert order == ["a", "b"] * 3
    assert {name: len(times) for name, times in taken.items()} == {"a": 2, "b": 2}


def test_threads_are_put_back() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    with pytest.raises(KeyError), one_thread():
        assert torch.get_num_threads() == 1
        raise KeyError
    assert torch.get_num_threads() == 2
    torch.set_num_threads(before)


def test_nothing_to_repeat_is_refused(tiny: TokenizerConfig) -> None:
    with pytest.raises(ContractError, match="at least 1"):
        speed_report(Tokenizer.random(tiny), SpeedConfig(repeats=0), {})
