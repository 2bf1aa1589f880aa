"""Touch for a policy without a tokenizer: a hand descriptor, or the marker images themselves.

Controls of the benchmark: the first asks whether learning was needed, the second must fail when a
sensor is swapped. Views and policies both come through here, so they can't disagree about a mirror
or a size.
"""

import numpy as np
import torch

from uniforce_vtla.contracts import Finger
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.descriptor import DESCRIPTOR_NAMES, describe
from uniforce_vtla.tokenizer.entry import prepare

DESCRIPTOR_SIZE = len(DESCRIPTOR_NAMES)
PAIR_SIDE = 32  # px: a GelSight's markers lie four apart, area averaging keeps their motion


def descriptors(reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
    """Return (B, 6) float32 descriptors of (B, H, W) uint8 images against a (H, W) reference."""
    before, after = (
        np.ascontiguousarray(to_canonical(image, finger)) for image in (reference, current)
    )
    return describe(before, after)


def marker_pairs(reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
    """Return (B, 2, PAIR_SIDE, PAIR_SIDE) uint8: reference and current, canonical, letterboxed."""
    before = prepare(reference, finger, PAIR_SIDE, "reference")
    after = prepare(current, finger, PAIR_SIDE, "current")
    pair = torch.cat([before.expand_as(after), after], dim=1)  # (B, 2, S, S)
    return (pair * 255).round().to(torch.uint8).numpy()
