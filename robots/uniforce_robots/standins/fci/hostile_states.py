"""States that say something else than the arm or the hand does: what a fault makes of each state, as datagrams."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from uniforce_robots.standins.fci.kinematics import DQ_MAX_rad_s, rotation_z
from uniforce_robots.standins.fci.protocol import (
    HAND_STATE_BYTES,
    STATE_BYTES,
    STATE_SLICES,
    HandState,
    RobotState,
)

ArmWire = Callable[[RobotState], Iterable[bytes]]
HandWire = Callable[[HandState], Iterable[bytes]]

MEASURED = ("O_T_EE", "q", "dq", "theta", "dtheta")
FORCES = ("tau_ext_hat_filtered", "O_F_ext_hat_K", "K_F_ext_hat_K")
JUMP_rad = 0.3  # about the first joint's axis: 0.1 m at the hand
BEYOND = 10.0  # × the joints' speed limits
FLOOD = 5  # old states a millisecond


def _with(state: RobotState, change: Callable[[np.ndarray], None]) -> bytes:
    """Return a state's bytes after a change of its numbers; the arm's own stay as they are."""
    floats = state.floats.copy()
    change(floats)
    return replace(state, floats=floats).encode()


def all_are(names: Sequence[str], value: float) -> ArmWire:
    """Say one value in place of every number of these fields."""

    def change(floats: np.ndarray) -> None:
        for name in names:
            floats[STATE_SLICES[name]] = value

    return lambda state: [_with(state, change)]


def turned(state: RobotState) -> Iterable[bytes]:
    """Say that the first joint has turned by 0.3 rad at once, and the hand with it."""

    def change(floats: np.ndarray) -> None:
        floats[STATE_SLICES["q"].start] += JUMP_rad
        floats[STATE_SLICES["theta"].start] += JUMP_rad
        pose = floats[STATE_SLICES["O_T_EE"]].reshape(4, 4).T
        floats[STATE_SLICES["O_T_EE"]] = (rotation_z(JUMP_rad) @ pose).T.ravel()

    yield _with(state, change)


def too_fast(state: RobotState) -> Iterable[bytes]:
    """Say ten times the speed that each joint can have."""

    def change(floats: np.ndarray) -> None:
        for name in ("dq", "dtheta"):
            floats[STATE_SLICES[name]] = BEYOND * DQ_MAX_rad_s

    yield _with(state, change)


def frozen(last: RobotState) -> ArmWire:
    """Say where the arm was, at the time that it is."""
    kept = {name: last[name].copy() for name in (*MEASURED, "O_dP_EE_d", "O_dP_EE_c")}

    def change(floats: np.ndarray) -> None:
        for name, values in kept.items():
            floats[STATE_SLICES[name]] = values

    return lambda state: [_with(state, change)]


def repeated(last: RobotState) -> ArmWire:
    """Send the same state for ever."""
    datagram = last.encode()
    return lambda _: [datagram]


def old(sent: Sequence[RobotState], source: random.Random) -> ArmWire:
    """Send old states in any order, several each millisecond, and no new one."""
    datagrams = [state.encode() for state in sent]
    return lambda _: source.choices(datagrams, k=FLOOD)


def silent(_: object) -> Iterable[bytes]:
    """Send nothing."""
    return ()


def garbage(size: int, source: random.Random) -> Callable[[object], Iterable[bytes]]:
    """Send random bytes in the place of each state."""
    return lambda _: [source.randbytes(size)]


def wrong_length(source: random.Random) -> Callable[[object], Iterable[bytes]]:
    """Send random bytes that no state can be, by their number."""
    sizes = (0, 1, 8, HAND_STATE_BYTES - 1, STATE_BYTES - 1, STATE_BYTES + 1, 4000)
    return lambda _: [source.randbytes(source.choice(sizes))]


def no_width(state: HandState) -> Iterable[bytes]:
    """Say that the width is no number."""
    yield replace(state, width_m=float("nan")).encode()
