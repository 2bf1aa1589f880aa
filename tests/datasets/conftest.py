import logging
import shutil
from pathlib import Path

import pytest

from uniforce_datasets.synthetic import BlockMeans, record_synthetic
from uniforce_datasets.training_view import build_view

EPISODES, FRAMES = 3, 20
logging.getLogger("lerobot").setLevel(logging.ERROR)


@pytest.fixture(scope="session")
def demos(tmp_path_factory):
    """Three synthetic episodes of twenty frames; read only."""
    return record_synthetic(tmp_path_factory.mktemp("demos") / "data", EPISODES, FRAMES)


@pytest.fixture
def copy(demos, tmp_path):
    """Those three episodes in a folder to change."""
    return Path(shutil.copytree(demos, tmp_path / "copy"))


@pytest.fixture(scope="session")
def view(demos, tmp_path_factory):
    return build_view(demos, tmp_path_factory.mktemp("view") / "view", encoder=BlockMeans())
