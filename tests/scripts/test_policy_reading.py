"""Which moments are looked at, and whose touch is given for whose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import policy_reading as module
from benchmarks.force_misreading import SITUATIONS
from benchmarks.policy_reading import Demos, PolicyReadingConfig, find_moments, main, read_forces
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import ACTION, truth_wrench_key

LENGTH, KINDS = 30, ["gelsight", "uskin"] * 10  # frames per episode, and the left finger's sensors
MISREAD_N = {"gelsight": 0.5, "uskin": -0.3}  # press, by a policy that learnt with the right finger
PRESS_mm_N, GRIP_mm_N = 0.4, 0.05
EXPERT_mm_N = 0.3  # by which the made-up demos open within AFTER steps, per N of grip
AFTER = 4


class MadeUp:
    """A reader whose policy answers press and grip, and misreads the left finger as stated."""

    slot, finger = "touch0", "right"

    def __init__(self, truth: dict[Finger, np.ndarray]) -> None:
        self._truth = truth

    def moves_mm(self, moments: np.ndarray, felt: np.ndarray, finger: Finger) -> np.ndarray:
        wrench = self._truth[finger][felt]
        press = -wrench[:, 1] + (
            np.array([MISREAD_N[KINDS[frame // LENGTH]] for frame in felt]) if finger == "left" else 0
        )
        return np.c_[PRESS_mm_N * press, GRIP_mm_N * wrench[:, 2]] + 0.1 * (moments[:, None] % 7)


@pytest.fixture
def view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The true wrenches and commands of a view; each episode carries in its first half and wipes in its second."""
    rng, number = np.random.default_rng(0), LENGTH * len(KINDS)
    for finger in FINGERS:
        wrench = rng.standard_normal((LENGTH * len(KINDS), 4)) * (1, 0.3, 1, 30) + (0, 0, 9, 0)
        wrench[np.arange(len(wrench)) % LENGTH >= LENGTH // 2, 1] -= 3.5
        np.save(tmp_path / f"{truth_wrench_key(finger)}.npy", wrench.astype(np.float32))
        if (
            finger == MadeUp.finger
        ):  # every AFTER-th command opens by what was gripped when the last ones began
            opened = EXPERT_mm_N / 1000 * wrench[:, 2]
    command = np.zeros((number, 5))
    for frame in range(AFTER, number):
        command[frame, 4] = command[frame - AFTER, 4] + opened[frame - AFTER + 1]
    np.save(tmp_path / f"{ACTION}.npy", command)
    episodes = [{"length": LENGTH, "left_sensor": kind, "right_sensor": "tactip"} for kind in KINDS]
    monkeypatch.setattr(module, "read_marker", lambda root: {"wrench": True, "episodes": episodes})
    return tmp_path


def test_moments_are_wipes_evenly_from_all_episodes(view: Path) -> None:
    moments = find_moments(Demos.read(view), "right", "wiping", PolicyReadingConfig(moments=5))
    assert len(set(moments.frames)) == 5 * len(KINDS)
    assert (moments.frames % LENGTH >= LENGTH // 2).all()
    assert list(moments.worn["left"]) == [KINDS[episode] for episode in moments.episode]
    with pytest.raises(DatasetError, match="moments of wiping"):
        find_moments(Demos.read(view), "right", "wiping", PolicyReadingConfig(moments=LENGTH))


def test_no_move_is_taken_across_an_episodes_border(view: Path) -> None:
    last = LENGTH - LENGTH // 2 - (AFTER - 1)  # wiping frames whose next commands are there
    moments = find_moments(
        Demos.read(view), "right", "wiping", PolicyReadingConfig(moments=last, after=AFTER)
    )
    assert (moments.frames % LENGTH).max() == LENGTH - AFTER
    with pytest.raises(DatasetError, match="moments of wiping"):
        find_moments(Demos.read(view), "right", "wiping", PolicyReadingConfig(moments=last + 1, after=AFTER))


def test_how_the_demos_answer_stands_beside(view: Path) -> None:
    moments = find_moments(Demos.read(view), "right", "carrying", PolicyReadingConfig(moments=4, after=AFTER))
    assert (moments.frames % LENGTH < LENGTH // 2).all()
    assert moments.demonstrated.of("grip") == pytest.approx(EXPERT_mm_N, rel=1e-3)


def test_a_misread_finger_comes_out_as_it_was_made(view: Path) -> None:
    truth = {finger: np.load(view / f"{truth_wrench_key(finger)}.npy") for finger in FINGERS}
    moments = find_moments(Demos.read(view), "right", "wiping", PolicyReadingConfig())
    answered, found = read_forces(MadeUp(truth), moments, SITUATIONS["wiping"].forces, 0)  # type: ignore[arg-type]
    assert answered.of("press") == pytest.approx(PRESS_mm_N) and answered.of("grip") == pytest.approx(
        GRIP_mm_N
    )
    assert {kind: forces["press"].mean_N for kind, forces in found.items()} == pytest.approx(
        MISREAD_N, abs=1e-4
    )
    assert all(abs(forces["grip"].mean_N) < 1e-4 for forces in found.values())


def test_without_a_checkpoint_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"policy={tmp_path}", f"view={tmp_path}"]) == 2
    assert str(tmp_path) in capsys.readouterr().err
