"""How many of our own files a demonstration passes on its way from the recorder to a sample of the trainer.

``python -m benchmarks.paths`` records a few made frames, builds the view with the shipped tokenizer, and takes one
sample; it prints how many files were entered in each step and in all. A file counts when one of its functions is
called, in whatever thread; imports don't count.
"""

import json
import logging
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.synthetic import FPS, synthetic_frame
from uniforce_datasets.training_view import TrainingView, build_view

ROOT = Path(__file__).parents[1]
ROOMS = ("uniforce_vtla/", "policies/", "envs/", "datasets/", "robots/", "scripts/")
FRAMES = 4  # of the one episode


@contextmanager
def counted_files(files: set[str]) -> Iterator[None]:
    """Add each own file to ``files`` that has a function called while the block lasts; by a profile hook."""

    def note(frame: FrameType, event: str, _: Any) -> None:
        name = frame.f_code.co_filename.removeprefix(f"{ROOT}/")
        if event == "call" and frame.f_code.co_name != "<module>" and name.startswith(ROOMS):
            files.add(name)

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def steps(folder: Path) -> dict[str, Callable[[], object]]:
    """Return record, view and sample, to be called in this order."""
    frames = [synthetic_frame(step, np.random.default_rng(step)) for step in range(FRAMES)]

    def record() -> None:
        with EpisodeRecorder(folder / "data", "local/paths", "gelsight", "tactip", FPS) as recorder:
            for frame in frames:
                recorder.add(frame, "wipe the dots")
            recorder.save(success=True, outcome="success", seed=0)

    return {
        "record": record,
        "view": lambda: build_view(folder / "data", folder / "view"),
        "sample": lambda: TrainingView(folder / "view", (-1, 0, 1))[1],
    }


def main() -> int:
    """Print the counts as JSON."""
    logging.getLogger("lerobot").setLevel(logging.ERROR)
    found: dict[str, set[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, step in steps(Path(folder)).items():
            with counted_files(found.setdefault(name, set())):
                step()
    whole = sorted(set().union(*found.values()))
    counts = {name: len(files) for name, files in found.items()}
    print(json.dumps({"own_files": len(whole), **counts, "files": whole}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
