"""One gain of a sensor's latents, from presses of known load on a kitchen scale.

No known sensor is needed. The bare pad is pressed on a handle. Or the tool that both fingers hold
is pressed: a covered flat gel shows shear and hardly grip.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.optimize import brentq

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent
from uniforce_vtla.tokenizer.latent_map import LatentMap

FEWEST_LOADS = 3
# newtons grow about with the square of a latent: a pad of a quarter to four times the stiffness
GAINS = (0.5, 2.0)
REST_SHARE = 0.3  # of the mean load: rms that a gain may leave; simulated TacTips leave .05 to .1
Y = 1  # of canonical newtons, down
Z = 2  # into the pad


def gain_of_loads(
    z: Latent, load_N: np.ndarray, head: ForceHead, new: str, free: torch.Tensor
) -> Calibration:
    """Return a map that scales latents about free air until the press read is the load.

    Args:
        z: (n, P, latent) of presses straight on the pad.
        load_N: (n,) shown by the scale, N.
        head: of the kind whose latents the policy knows.
        new: the sensor, in words.
        free: (P, latent) of free air.

    Raises ContractError: fewer than three loads, or readings that no gain brings to them.
    """
    known_N = np.asarray(load_N, float)
    _check_loads(known_N, len(z), known_N > 0, f"{FEWEST_LOADS} or more different ones")

    def read_at(gain: float) -> np.ndarray:
        return _newtons_at(gain, z, head, free)[:, Z]

    do = (
        "Are loads in newtons, and is the reference of free air? "
        "A covered flat gel is weighed with through=tool."
    )
    return _scaled(_gain(known_N, read_at, do), head, new, free)


def gain_through_a_tool(
    z: Latent, load_N: np.ndarray, head: ForceHead, new: str, free: torch.Tensor
) -> Calibration:
    """Return a map that scales latents until the shear read is half the load on the held tool.

    Half of a load comes up through each finger. Arguments as ``gain_of_loads``; load 0 is the tool
    hanging free.

    Raises ContractError: as ``gain_of_loads``, or no frame of the hanging tool.
    """
    known_N = np.asarray(load_N, float)
    is_free = known_N == 0
    wanted = f"0 and {FEWEST_LOADS} or more different ones"
    _check_loads(known_N, len(z), (known_N >= 0) & is_free.any(), wanted)

    def read_at(gain: float) -> np.ndarray:
        shear_N = _newtons_at(gain, z, head, free)[:, Y]
        return shear_N[is_free].mean() - shear_N[~is_free]

    do = "Is the reference of free air, and do tool and sensor stand upright?"
    return _scaled(_gain(known_N[~is_free] / 2, read_at, do), head, new, free)


def _check_loads(known_N: np.ndarray, count: int, fits: np.ndarray, wanted: str) -> None:
    """Raise ContractError unless there is a load for each frame, and enough different ones."""
    different = set(known_N[known_N > 0])
    is_right = len(known_N) == count and bool((np.isfinite(known_N) & fits).all())
    if not is_right or len(different) < FEWEST_LOADS:
        came = f"{known_N.tolist()} for {count} frames"
        do = "Press with 3, 6 and 9 N."
        raise ContractError(expected("loads", wanted, came, do))


def _newtons_at(gain: float, z: Latent, head: ForceHead, free: torch.Tensor) -> np.ndarray:
    scaled = LatentMap.scaling(gain, free)(z)
    return head(Latent.of(scaled, head.tokenizer_hash)).double().numpy()


def _gain(known_N: np.ndarray, read_at: Callable[[float], np.ndarray], do: str) -> float:
    """Return the gain whose readings (n,) have no part along the known loads (n,) left over.

    Raises ContractError: there is none, or readings don't follow the loads.
    """

    def excess(gain: float) -> float:
        return float((known_N * (read_at(gain) - known_N)).sum())

    lowest, highest = GAINS
    came = f"{np.round(read_at(1.0), 1).tolist()} N read of {known_N.tolist()}"
    wanted = f"readings that a gain of latents of {lowest} to {highest} brings to the loads"
    if not excess(lowest) < 0 < excess(highest):
        raise ContractError(expected("presses", wanted, came, do))
    gain = float(brentq(excess, lowest, highest, xtol=1e-3))
    rest_N = float(np.sqrt(((read_at(gain) - known_N) ** 2).mean()))
    if rest_N > REST_SHARE * known_N.mean():
        raise ContractError(expected("presses", wanted, came, do))
    return gain


def _scaled(gain: float, head: ForceHead, new: str, free: torch.Tensor) -> Calibration:
    return Calibration(
        map=LatentMap.scaling(gain, free),
        tokenizer_hash=head.tokenizer_hash,
        head_hash=head.hash,
        new=new,
        anchor=new,
        ridge=0.0,
        turn_deg=0.0,
        agreement={},
    )
