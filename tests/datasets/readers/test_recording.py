from dataclasses import replace

import numpy as np
import pytest

from uniforce_datasets.readers import ForceAxes, LabelledRecording, PairRecording
from uniforce_datasets.readers.genforce import check_compression
from uniforce_vtla.errors import ContractError, DatasetError

IMAGE = np.zeros((48, 64), np.uint8)
IMAGE[10:20, 10:20] = 255


def recording(**changes: object) -> LabelledRecording:
    whole = LabelledRecording("g", "cone", "1", IMAGE, np.stack([IMAGE] * 3), np.zeros((3, 3), np.float32))
    return replace(whole, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": np.zeros((0, 48, 64), np.uint8)},
        {"frames": np.zeros((3, 48, 60), np.uint8)},
        {"frames": np.full((3, 48, 64), 128, np.uint8)},
        {"frames": np.zeros((3, 48, 64), np.float32)},
        {"reference": np.full((48, 64), 1, np.uint8)},
        {"force_N": np.zeros((2, 3), np.float32)},
        {"force_N": np.zeros((3, 3), np.float64)},
        {"force_N": np.full((3, 3), np.nan, np.float32)},
    ],
)
def test_a_recording_outside_the_form_is_refused(changes: dict[str, object]) -> None:
    assert len(recording().frames) == 3
    with pytest.raises(DatasetError, match="g/cone/1"):
        recording(**changes)


def test_pairs_of_different_length_are_refused() -> None:
    two, three = np.stack([IMAGE] * 2), np.stack([IMAGE] * 3)
    with pytest.raises(DatasetError, match="as many left as right"):
        PairRecording(("g", "t"), "cone", "p", IMAGE, IMAGE, two, three)


def test_axes_are_a_signed_permutation() -> None:
    recorded = np.array([[1.0, 2.0, -3.0, 99.0, 99.0, 99.0]])
    assert ForceAxes().to_image(recorded).tolist() == [[1.0, 2.0, 3.0]]
    assert ForceAxes("-y", "+x", "-z").to_image(recorded).tolist() == [[-2.0, 1.0, 3.0]]


@pytest.mark.parametrize("axes", [("+x", "+x", "+z"), ("x", "+y", "-z"), ("+x", "+y", "+w"), ("", "", "")])
def test_axes_that_are_none_are_refused(axes: tuple[str, str, str]) -> None:
    with pytest.raises(ContractError, match="force axes"):
        ForceAxes(*axes)


def test_a_trial_that_pulls_is_refused_and_drift_is_not() -> None:
    check_compression(np.array([[0, 0, -1.5], [0, 0, 0.2]]), "drift")
    check_compression(np.array([[0, 0, -2.5], [0, 0, 9.0]]), "sticky release")
    with pytest.raises(DatasetError, match=r"7\.0 N of pull"):
        check_compression(np.array([[0, 0, 0.4], [0, 0, -7.0]]), "wrong sign")
