"""Benchmarks that run on several processes: their workers must find every function by name."""

import ast
from pathlib import Path

import pytest

PROGRAMS = sorted(
    path
    for path in (Path(__file__).parents[2] / "benchmarks").rglob("*.py")
    if '__name__ == "__main__"' in path.read_text() and "delayed(" in path.read_text()
)


def cached_functions(source):
    """Return the functions that a module keeps the results of."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
            if any("cache" in decorator for decorator in decorators):
                found.append(node.name)
    return found


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_a_program_sends_no_cached_function_of_its_own_to_workers(path):
    """Such a function is sent as ``__main__.NAME``, which a worker doesn't have: a broken pool."""
    assert cached_functions(path.read_text()) == []


def test_a_cached_function_is_found():
    assert len(PROGRAMS) >= 3
    source = "from functools import cache\n@cache\ndef models(): ..."
    assert cached_functions(source) == ["models"]
