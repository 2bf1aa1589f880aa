import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from filelock import FileLock

from uniforce_vtla.tokenizer.settings import TokenizerConfig

# fair_clock, properties: importlib mode gives test folders no package
sys.path.insert(0, str(Path(__file__).parent))
import properties  # noqa: F401  (registers the profiles)
from fair_clock import FairClock

torch.set_num_threads(1)
TINY = TokenizerConfig(
    side=32, patch=8, width=16, depth=2, decoder_depth=1, heads=2, embed_hidden=16
)


@pytest.fixture
def tiny():
    return TINY


@pytest.fixture
def dots():
    """(3, 96, 128) uint8: a free-air image, then the same dots moved 4 px right, then 4 px down."""
    images = np.zeros((3, 96, 128), np.uint8)
    for image, (dx, dy) in zip(images, ((0, 0), (4, 0), (0, 4)), strict=True):
        for row in range(16, 96, 24):
            for column in range(16, 128, 24):
                image[row + dy : row + dy + 8, column + dx : column + dx + 8] = 255
    return images


@pytest.fixture
def refuses(capsys):
    """Return a function: a command ends with code 2 over some words, and its error holds a text."""

    def check(main, words, said):
        assert main(words) == 2
        assert said in capsys.readouterr().err

    return check


@pytest.fixture(scope="session")
def drawn_demo(tmp_path_factory, request):
    """One demo of the expert at level easy, scene 3, recorded once for all processes of a run.

    Sensors are as drawn, the only ones that the shipped heads of recordings know.
    """
    from uniforce_cli.record import RecordConfig, record

    folder = tmp_path_factory.getbasetemp()
    if hasattr(request.config, "workerinput"):
        folder = folder.parent
    root = folder / "drawn_demo"
    drawn = {"left_sensor": "gelsight:drawing", "right_sensor": "tactip:drawing"}
    with FileLock(f"{root}.lock"):
        if not root.exists():
            record(RecordConfig(episodes=1, level="easy", root=str(root), seed=3, **drawn))
    return root


# These hold no clock against what they test: whole programs, or calculations.
PATIENT = (
    "test_lossy_recording.py",
    "test_recorder_trials.py",
    "test_command.py",
    "test_store_process.py",
)
PATIENT += ("test_checks.py", "test_limits.py", "test_guards.py", "test_hand.py")
PATIENT += ("test_fci_model.py", "test_fci_protocol.py")
REALTIME = ("sensors", "recorder", "franka", "standins", "teleop")  # folders of tests/robots
BENCHMARKS = Path(__file__).parent / "benchmarks"  # they only prove our figures
PROMPT = ("test_frozen_draws.py",)  # of them: two seconds, and every change of simulation is tried


def pytest_configure(config):
    config.pluginmanager.register(FairClock(), "fair_clock")


def pytest_collection_modifyitems(config, items):
    """Mark what runs against a clock, and what `make test` leaves to `make thorough`.

    With several processes begin with the files that would end last.
    """
    for item in items:
        if (
            item.path.parent.parent.name == "robots"
            and item.path.parent.name in REALTIME
            and item.path.name not in PATIENT
        ):
            item.add_marker("realtime")
        if item.path.is_relative_to(BENCHMARKS) and item.path.name not in PROMPT:
            item.add_marker("thorough")
    if hasattr(config, "workerinput"):
        long = {item.path for item in items if item.get_closest_marker("timeout")}
        items.sort(key=lambda item: item.path not in long)  # stable: the rest stays in its order
