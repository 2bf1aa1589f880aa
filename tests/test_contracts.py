from __future__ import annotations

import numpy as np
import pytest

from uniforce_vtla.contracts import ContactState, MarkerPair, check_finger, check_marker_image
from uniforce_vtla.errors import ContractError

BLANK = np.zeros((480, 640), np.uint8)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((480, 640, 3), np.uint8),
        np.zeros((480, 640), np.float32),
        np.zeros((0, 640), np.uint8),
        np.full((4, 4), 7, np.uint8),
        [[0, 255]],
    ],
)
def test_what_is_no_marker_image_is_refused(image: object) -> None:
    with pytest.raises(ContractError, match="expected"):
        check_marker_image(image)  # type: ignore[arg-type]


def test_a_pair_needs_equal_sizes_and_a_finger() -> None:
    with pytest.raises(ContractError, match="pair"):
        MarkerPair(BLANK, BLANK[:, :320], "left", "gelsight")
    with pytest.raises(ContractError, match="left or right"):
        MarkerPair(BLANK, BLANK, "thumb", "gelsight")  # type: ignore[arg-type]
    assert check_finger("left") == "left"


@pytest.mark.parametrize(
    ("force", "torsion", "reason"),
    [
        (np.zeros((1, 2)), np.zeros(1), "one row|One row"),
        (np.array([[0, 0, np.nan]]), np.zeros(1), "finite"),
        (np.array([[0, 0, -1.0]]), np.zeros(1), "compression"),
    ],
)
def test_impossible_contacts_are_refused(force: np.ndarray, torsion: np.ndarray, reason: str) -> None:
    with pytest.raises(ContractError, match=reason):
        ContactState(np.zeros((1, 4, 4)), force, torsion)
