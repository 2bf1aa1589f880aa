"""The project's own source, for tests that read all of it."""

import shutil
import tomllib
from pathlib import Path

import pytest

from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_vtla.file_hashes import drop_hashes

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def source_files():
    """Every module the wheel packs, and the scripts: a folder that is packed can't be forgotten
    here."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    packages = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    return [file for folder in (*packages, "scripts") for file in (ROOT / folder).rglob("*.py")]


@pytest.fixture
def policy_copy(tmp_path):
    """Return a copy of the shipped policy without hashes: they would refuse whatever a test does to
    it."""
    shutil.copytree(shipped_checkpoint(), tmp_path / "policy")
    drop_hashes(tmp_path / "policy")
    return tmp_path / "policy"
