"""Rows of other people's ideas in the force table: trained here, or read from official weights on disk."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.baselines.anytouch import anytouch_row
from benchmarks.baselines.finetuned import finetuned_row
from benchmarks.baselines.genforce_style import genforce_style_row
from benchmarks.baselines.resnet import resnet_row
from benchmarks.baselines.speed import speed_report
from benchmarks.baselines.t3 import t3_row
from benchmarks.baselines.unit import unit_row
from benchmarks.probes.zero_shot import Cells, Table
from uniforce_vtla.tokenizer.api import Tokenizer


def trained(table: Table, tokenizer: Tokenizer, seeds: int) -> dict[str, Callable[[], Cells]]:
    """Return the makers of rows that train networks: name → maker."""
    makers: dict[str, Callable[[], Cells]] = {
        "UniForce (FT)": lambda: finetuned_row(table, tokenizer, seeds),
        "ResNet": lambda: resnet_row(table, seeds),
    }
    if set(table.frozen) <= set(table.training):  # a translator needs pictures of its target
        makers["GenForce-style (ours)"] = lambda: genforce_style_row(table, 1)
    return makers


def published(table: Table, tokenizer: Tokenizer, seeds: int, paths: dict[str, str], t3_encoder: str) -> dict[str, Any]:
    """Return the published encoders' rows (n/a without their weights) and the speed of all."""
    found = {name: Path(path) if path else None for name, path in paths.items()}
    return {
        "published_encoders": {
            "AnyTouch": anytouch_row(table, seeds, found["anytouch"]).as_dict(),
            "T3": t3_row(table, seeds, found["t3"], t3_encoder).as_dict(),
            "UniT": unit_row(table, seeds, found["unit"]).as_dict(),
        },
        "speed": speed_report(tokenizer)["encoders"],
    }
