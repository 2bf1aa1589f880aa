"""Rows of other people's ideas in the force table, trained here."""

from collections.abc import Callable

from benchmarks.baselines.finetuned import finetuned_row
from benchmarks.baselines.genforce_style import genforce_style_row
from benchmarks.baselines.resnet import resnet_row
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
