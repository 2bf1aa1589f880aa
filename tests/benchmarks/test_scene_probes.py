"""What the scene asks of touch: a leak check with known answers, and what a policy looks at."""

import numpy as np
import pytest

from benchmarks.leak_check import FRAMES, PAST, TOUCHING_N, LeakConfig, Samples, collect, verdict
from benchmarks.leak_check import measure as measure_leak
from uniforce_vtla.tokenizer.plain_touch import DESCRIPTOR_SIZE


def made_up(leaky: bool) -> Samples:
    """Forty scenes whose touch predicts the press; the pose does only where the scene leaks."""
    rng = np.random.default_rng(0)
    n = 600
    press = rng.uniform(3, 12, n)
    pose = rng.standard_normal((n, 5 * PAST))
    if leaky:
        pose[:, 2] = press + 0.1 * rng.standard_normal(n)
    touch = rng.standard_normal((n, 2 * DESCRIPTOR_SIZE))
    touch[:, 1] = press + 0.1 * rng.standard_normal(n)
    cameras = rng.integers(0, 255, (n, 18, 8, 8)).astype(np.uint8)
    return Samples(pose, pose.copy(), touch, cameras, press, np.arange(n) % 40)


def test_a_leak_is_found_and_no_leak_is_not() -> None:
    leak, tight = (measure_leak(made_up(leaky), cnn_steps=5) for leaky in (True, False))
    assert leak["pose"] > 0.9 and verdict(leak).startswith("LEAK")
    assert tight["pose"] < 0.1 < 0.9 < tight["touch"] and verdict(tight).startswith("no leak")


def test_a_check_that_touch_fails_too_proves_nothing() -> None:
    blind = dict.fromkeys(("pose", "pose and own targets", "cameras and pose"), 0.0)
    assert verdict(blind | {"touch and pose": 0.5}).startswith("proves nothing")


def test_moves_are_changes_of_the_targets_and_count_as_blind() -> None:
    samples = made_up(leaky=False)
    samples.command[:, 2] = samples.command[:, 7] - samples.press_N  # z of the first frame against the second
    assert np.allclose(samples.moves[:, 2], samples.press_N)
    found = measure_leak(samples, cnn_steps=5)
    assert found["pose"] < 0.1 < 0.9 < found["pose and own moves"] and verdict(found).startswith("LEAK")


@pytest.mark.slow
def test_samples_are_moments_of_wiping_with_their_past() -> None:
    samples = collect(LeakConfig(level="easy", scenes=3, image_side=28))
    n = len(samples.press_N)
    assert n > 10 and set(samples.scene) == {0, 1, 2}
    assert samples.pose.shape == samples.command.shape == (n, 5 * PAST) and samples.cameras.shape == (
        n,
        6 * FRAMES,
        28,
        28,
    )
    assert (samples.press_N > TOUCHING_N).all()  # wiping, not leaving the board
    moved = samples.pose[:, 1] - samples.pose[:, -4]  # y, first frame against the last
    assert np.abs(moved).max() > 0.005
