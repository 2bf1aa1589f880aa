"""Loads that both fingers carry tell how one sensor is mounted; pinched objects and few readings
don't."""

import numpy as np
import pytest

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.mount_relation import FEWEST, SETTINGS, mount_relation

SIGNS = {"upright": (1, 1), "turned": (-1, -1), "mirrored_x": (-1, 1), "mirrored_y": (1, -1)}


def carried(n=60, seed=0):
    return np.random.default_rng(seed).normal(0, 2, (n, 2))


@pytest.mark.parametrize("mount", SETTINGS)
@pytest.mark.parametrize("gain", [0.4, 2.5])
def test_each_mount_is_told_apart_whatever_the_gain_and_offset(mount, gain):
    known = carried()
    read = gain * (known * SIGNS[mount] + np.random.default_rng(1).normal(0, 0.8, known.shape)) + 3
    found = mount_relation(read, known)
    assert found.mount == mount and tuple(np.sign(found.r)) == SIGNS[mount]


def test_one_axis_without_load_leaves_it_undecided():
    known = carried() * (1, 0)
    noise = np.random.default_rng(1).normal(0, 0.3, (2, *known.shape))
    found = mount_relation(known + noise[0], known + noise[1])
    assert found.mount == "undecided" and found.r[0] > 0.9


def test_a_quarter_turn_unrelated_readings_and_too_few_are_undecided():
    known = carried()
    assert mount_relation(known[:, ::-1] * (1, -1), known).mount == "undecided"
    assert mount_relation(carried(seed=1), known).mount == "undecided"
    few = known[: FEWEST - 1]
    assert mount_relation(few, few).mount == "undecided"


def test_readings_that_are_not_paired_are_refused():
    with pytest.raises(ContractError, match=r"\(n, 2\) twice"):
        mount_relation(carried(20), carried(19))
    with pytest.raises(ContractError, match="finite"):
        mount_relation(carried(), np.full((60, 2), np.nan))
