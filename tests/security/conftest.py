"""What the project's own source is, for tests that read all of it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def source_files() -> list[Path]:
    """Every module the wheel packs, and the scripts: a folder that is packed can't be forgotten here."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    packages = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    return [file for folder in (*packages, "scripts") for file in (ROOT / folder).rglob("*.py")]
