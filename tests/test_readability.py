"""The shipped code reads line by line: what a reader has to unpack, per 1,000 code tokens, stays
low."""

import ast
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHIPPED = ("uniforce_vtla", "policies", "envs", "datasets", "robots", "scripts")
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
COMPREHENSIONS = (ast.GeneratorExp, ast.ListComp, ast.DictComp, ast.SetComp)
# several names bound from a tuple or generator, comprehensions, inline conditions; per 1,000 tokens
MOST = {"unpack": 0.8, "comprehension": 2.2, "inline condition": 1.2}


def files():
    return [file for room in SHIPPED for file in sorted((ROOT / room).rglob("*.py"))]


def code_tokens(file):
    """Count the tokens that are neither layout nor comments nor docstrings."""
    count = 0
    starts_statement = True
    with file.open("rb") as stream:
        for token in tokenize.tokenize(stream.readline):
            if token.type in LAYOUT:
                starts_statement |= token.type in (tokenize.NEWLINE, tokenize.INDENT)
                continue
            count += not (starts_statement and token.type == tokenize.STRING)
            starts_statement = False
    return count


def found_in(tree):
    counts = dict.fromkeys((*MOST, "nested"), 0)
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            packed = isinstance(node.value, ast.Tuple | ast.GeneratorExp | ast.ListComp)
            counts["unpack"] += packed
        counts["comprehension"] += isinstance(node, COMPREHENSIONS)
        if isinstance(node, ast.IfExp):
            counts["inline condition"] += 1
            inner = [child for child in ast.walk(node) if isinstance(child, ast.IfExp)]
            counts["nested"] += len(inner) > 1
    return counts


def test_what_is_counted():
    code = "a, b = 1, 2\nc, d = (x for x in f)\ne = 1 if (2 if p else q) else 3\ng, h = both()\n"
    assert found_in(ast.parse(code)) == {
        "unpack": 2, "comprehension": 1, "inline condition": 2, "nested": 1
    }  # fmt: skip


@pytest.fixture(scope="module")
def totals():
    total = dict.fromkeys((*MOST, "nested"), 0)
    for file in files():
        for name, count in found_in(ast.parse(file.read_text())).items():
            total[name] += count
    return total


def test_few_things_have_to_be_unpacked(totals):
    tokens = sum(map(code_tokens, files()))
    for name, most in MOST.items():
        assert totals[name] <= most * tokens / 1000, name
    assert totals["nested"] == 0
