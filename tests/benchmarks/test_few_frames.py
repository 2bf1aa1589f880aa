import numpy as np
import pytest

from benchmarks.real.few_frames import ForceCorrection
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.calibrate import in_plane_turn_rad


def frames(n=12, noise_N=0.0):
    """A sensor turned by 30°, with twice the shear, two thirds of the press and an offset."""
    rng = np.random.default_rng(0)
    known = rng.uniform([-3, -3, 0], [3, 3, 10], (n, 3))
    cos, sin = np.cos(np.pi / 6), np.sin(np.pi / 6)
    shear = 2 * known[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    read = np.column_stack([shear, known[:, 2] / 1.5 + 0.4])
    return read + noise_N * rng.standard_normal(read.shape), known


def test_angle_gain_and_offset_are_found():
    read, known = frames()
    found = ForceCorrection.fit(read, known)
    assert found.turn_rad == pytest.approx(np.pi / 6)
    assert np.allclose(found.gain, (0.5, 0.5, 1.5)) and np.allclose(found(read), known)


def test_ten_noisy_frames_are_of_use():
    read, known = frames(200, noise_N=0.2)
    found = ForceCorrection.fit(read[:10], known[:10])
    assert np.abs(found(read) - known).mean() < 0.3 < np.abs(read - known).mean()


def test_the_turn_is_that_of_the_shear_plane_alone():
    v = np.random.default_rng(1).standard_normal((9, 2))
    assert in_plane_turn_rad(v, v + 5.0) == pytest.approx(0)
    assert in_plane_turn_rad(v, v[:, ::-1] * [-1, 1]) == pytest.approx(np.pi / 2)


def test_frames_that_say_too_little_are_refused():
    read, known = frames()
    for bad_read, bad_known, says in (
        (read[:9], known[:9], "Record more"),
        (read * np.nan, known, "finite"),
        (read, known * (1, 0, 1), "never loaded"),
    ):
        with pytest.raises(ContractError, match=says):
            ForceCorrection.fit(bad_read, bad_known)
