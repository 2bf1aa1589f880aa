"""How many of our own files one call passes, and how often it changes from one top-level room to another."""

import json
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from lerobot_policy_pi05_uniforce.controller import PolicyController, shipped_checkpoint
from uniforce_vtla.contact import TactileSimulator
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.markers import Canonicalizer

ROOT = Path(__file__).parents[2]
ROOMS = ("uniforce_vtla", "policies", "envs", "datasets", "robots", "scripts")
TASK = "wipe the ink off the board"


def passed_files(call: Callable[[], Any]) -> list[str]:
    """Return the own file of every Python function that one call enters, in order; by a profile hook."""
    passed: list[str] = []

    def note(frame: FrameType, event: str, _: Any) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in ROOMS:
            passed.append(str(path.relative_to(ROOT)))

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return passed


def frame_to_action() -> Callable[[], np.ndarray]:
    """Return a call from a TacTip's raw frames to the action of the shipped tiny policy, (n, 5); run once before."""
    simulator, canonicalizer = TactileSimulator("tactip"), Canonicalizer("tactip")
    reference, current = simulator.raw_reference(), simulator.raw_reference()
    worn = dict.fromkeys(FINGERS, "tactip")
    controller = PolicyController(shipped_checkpoint(), worn, asked=worn)
    (finger,) = controller.config.finger_by_slot().values()

    def call() -> np.ndarray:
        pair = canonicalizer.pair(reference, current, finger)
        images = {f"tactile_{finger}": pair.current, f"tactile_{finger}_ref": pair.reference}
        pixels = {name: np.repeat(image[..., None], 3, axis=2) for name, image in images.items()}
        pixels |= {name: np.zeros((56, 56, 3), np.uint8) for name in ("front", "wrist")}
        state = np.array([0.5, 0.0, 0.05, 0.0, 0.04], np.float32)
        return controller.chunk({"pixels": pixels, "agent_pos": state}, TASK)

    call()
    controller.policy.reset()
    return call


def main() -> int:
    """Print the counts: python -m benchmarks.policy.path."""
    passed = passed_files(frame_to_action())
    rooms = [file.split("/")[0] for file in passed]
    changes = sum(before != after for before, after in pairwise(rooms))
    print(json.dumps({"own_files": len(set(passed)), "changes_of_room": changes, "files": sorted(set(passed))}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
