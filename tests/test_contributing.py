"""CONTRIBUTING names one file for each usual change; its example is made here, on a copy."""

import re
import types
from pathlib import Path

import torch
from policy_samples import small_config

from lerobot_policy_pi05_uniforce.touch import tokens

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text()
MOST_LINES = 40


def test_every_named_file_exists():
    table = re.search(r"\| to change \|.*?\n\n", PAGE, re.DOTALL)
    named = re.findall(r"`([\w/]+/\w*(?:\.py)?)`", table[0])
    assert len(named) >= 5 and not [name for name in named if not (ROOT / name).exists()]


def changed():
    """Return the file of the example's diff, and its text after the change."""
    diff = re.search(r"```diff\n(.*?)```", PAGE, re.DOTALL)
    lines = diff[1].splitlines()
    assert len(lines) <= MOST_LINES
    file = ROOT / lines[1].removeprefix("+++ b/")
    before = [line[1:] for line in lines[3:] if line[0] in " -"]
    after = [line[1:] for line in lines[3:] if line[0] in " +"]
    text = file.read_text()
    assert text.count("\n".join(before)) == 1
    return file, text.replace("\n".join(before), "\n".join(after))


def test_the_examples_change_reaches_the_tokens_from_one_file():
    file, text = changed()
    module = types.ModuleType("changed_tokens")
    exec(compile(text, str(file), "exec"), vars(module))
    config = small_config()
    made = []
    for source in (tokens, module):
        torch.manual_seed(0)  # the same weights
        made.append(source.ForceTokens(config, (1, 3), 32))
    force_N = torch.tensor([[[1.0, -3.0, 8.0]]])
    before, after = (one(force_N, 0) for one in made)
    assert before.shape == after.shape == (1, config.tokens_per_slot, 32)
    assert (before - after).abs().max() > 0.01
