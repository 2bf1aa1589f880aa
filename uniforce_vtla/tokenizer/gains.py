"""One gain for a sensor: from presses of known load, from a tool weighed on a scale, or from wipes.

A kitchen scale needs no known sensor: three presses give one gain of the newtons. Pressing the tool
that the fingers hold gives one of shear: a covered flat gel shows shear and hardly grip. Without a
scale, wiping with the tool between a known finger and the new one does: each carries half the
press. A policy that feels whole latents needs a gain of those.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import brentq

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.calibration_choice import GAINS
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent
from uniforce_vtla.tokenizer.latent_map import LatentMap

FEWEST_LOADS = 3
TOOL_UPRIGHT = "Is the reference of free air, and do tool and sensor stand upright?"
REST_SHARE = 0.3  # of the mean load: rms that a gain may leave; simulated TacTips leave .05 to .1
HELD_N = 1.0  # grip that the anchor reads, from which on both fingers hold the tool
FEWEST_HELD = 30  # moments
LEAST_SPREAD_N = 0.25  # of the anchor's shear; a tool that is only carried shows little but noise
LEAST_R = 0.7  # between the fingers' shear
# of latents: about the roots of GAINS, since newtons grow about with the square of a latent
LATENT_GAINS = (0.5, 2.0)


def gain_of_loads(z: Latent, load_N: np.ndarray, head: ForceHead, new: str) -> Calibration:
    """Return the gain from newtons read of presses (n, P, latent) to their loads (n,) in N.

    One gain serves all axes: a stiffer or duller pad answers less to any force.

    Raises ContractError: fewer than three loads, or readings that don't follow them by such a gain.
    """
    known_N = np.asarray(load_N, float)
    read_N = _newtons(head, z)[:, 2]
    is_positive = bool((np.isfinite(known_N) & (known_N > 0)).all())
    if len(known_N) != len(read_N) or len(set(known_N)) < FEWEST_LOADS or not is_positive:
        came = f"{known_N.tolist()} for {len(read_N)} frames"
        wanted = f"{FEWEST_LOADS} or more different ones, one a frame"
        raise ContractError(expected("loads", wanted, came, "Press with 3, 6 and 9 N."))
    do = (
        "Are loads in newtons, and is the reference of free air? "
        "A covered flat gel is weighed with through=tool."
    )
    return _gain_alone(z, head, new, new, _gain(known_N, read_N, do))


def gain_through_a_tool(z: Latent, load_N: np.ndarray, head: ForceHead, new: str) -> Calibration:
    """Return the gain of shear of a finger that holds a tool, pressed on a scale with known loads.

    Half of a load comes up through each finger. Grip isn't weighed: a policy holds it.

    Args:
        z: (n, P, latent) of presses, and of the tool hanging free, load 0.
        load_N: (n,) shown by the scale, N.
        head: of the kind whose newtons the policy knows.
        new: the sensor, in words.

    Raises ContractError: fewer than three loads, none of a hanging tool, or readings that don't
    follow.
    """
    carried_N, is_free = _carried(load_N, len(z))
    gain = _gain(carried_N, _shear_of_presses(head, z, is_free), TOOL_UPRIGHT)
    return _gain_alone(z, head, new, new, gain, through_tool=True)


def latent_gain_through_a_tool(
    z: Latent, load_N: np.ndarray, head: ForceHead, new: str, free: torch.Tensor
) -> Calibration:
    """Return a map that scales latents about free air until the shear read follows known loads.

    Args:
        z: (n, P, latent) of presses, and of the tool hanging free, load 0.
        load_N: (n,) shown by the scale, N.
        head: of the kind whose latents the policy knows.
        new: the sensor, in words.
        free: (P, latent) of free air.

    Raises ContractError: as ``gain_through_a_tool``, or no gain between .5 and 2 does it.
    """
    carried_N, is_free = _carried(load_N, len(z))

    def shear_at(gain: float) -> np.ndarray:
        scaled = Latent.of(LatentMap.scaling(gain, free)(z), head.tokenizer_hash)
        return _shear_of_presses(head, scaled, is_free)

    def excess(gain: float) -> float:
        return float((carried_N * (shear_at(gain) - carried_N)).sum())

    lowest, highest = LATENT_GAINS
    if not excess(lowest) < 0 < excess(highest):
        came = f"{np.round(shear_at(1.0), 1).tolist()} N read of {carried_N.tolist()}"
        wanted = f"readings that a gain of latents of {lowest} to {highest} brings to the loads"
        raise ContractError(expected("presses", wanted, came, TOOL_UPRIGHT))
    gain = brentq(excess, lowest, highest, xtol=1e-3)
    _gain(carried_N, shear_at(gain), TOOL_UPRIGHT)
    return replace(_gain_alone(z, head, new, new, 1.0), map=LatentMap.scaling(gain, free))


def _carried(load_N: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return each finger's half of the loads above zero, N, and (n,) bool: the tool hangs free.

    Raises ContractError: fewer than three loads, or none of a hanging tool.
    """
    known_N = np.asarray(load_N, float)
    is_free = known_N == 0
    are_loads = bool((np.isfinite(known_N) & (known_N >= 0)).all())
    is_enough = len(set(known_N[~is_free])) >= FEWEST_LOADS and bool(is_free.any())
    if len(known_N) != count or not are_loads or not is_enough:
        came = f"{known_N.tolist()} for {count} frames"
        wanted = f"0 and {FEWEST_LOADS} or more different ones"
        do = "Let it hang free, then press with 3, 6 and 9 N."
        raise ContractError(expected("loads", wanted, came, do))
    return known_N[~is_free] / 2, is_free


def _shear_of_presses(head: ForceHead, z: Latent, is_free: np.ndarray) -> np.ndarray:
    """Return by how many N each press pushes the tool up; canonical y points down."""
    shear_N = _newtons(head, z)[:, 1]
    return shear_N[is_free].mean() - shear_N[~is_free]


def gain_beside_an_anchor(
    z_new: Latent,
    z_anchor: Latent,
    head: ForceHead,
    new: str,
    anchor: str,
    before: tuple[Latent, Latent] | None = None,
) -> Calibration:
    """Return the gain of shear of a finger that wipes with a tool beside a known finger.

    Args:
        z_new: (n, P, latent) of the new sensor while both fingers hold the tool.
        z_anchor: (n, P, latent) of the known one at the same moments.
        head: of the kind whose newtons the policy knows.
        new: the sensor to scale, in words.
        anchor: the known one, in words.
        before: (m, P, latent) of the sensor that ``new`` replaces, and of the known one beside it.
            Fingers don't carry equal shares of a press: with it the new sensor is scaled to what
            the replaced one read. None: to what the known one reads.

    Raises ContractError: latents that aren't paired, too few moments in which the tool is held, or
    shear that hardly changes or that the fingers disagree about.
    """
    gain = _spread_to_anchor(z_new, z_anchor, head)
    if before is not None:
        gain /= _spread_to_anchor(*before, head)
    return _gain_alone(z_new, head, new, anchor, gain, through_tool=True)


def _spread_to_anchor(z_new: Latent, z_anchor: Latent, head: ForceHead) -> float:
    """Return the known finger's spread of shear over the other one's, while both hold the tool."""
    if z_new.shape != z_anchor.shape:
        came = f"{tuple(z_new.shape)} and {tuple(z_anchor.shape)}"
        raise ContractError(
            expected("paired latents", "(n, P, latent) twice", came, "Pair them by frame.")
        )
    read_N = _newtons(head, z_new)
    known_N = _newtons(head, z_anchor)
    is_held = known_N[:, 2] > HELD_N
    return shear_gain(read_N[is_held, 1], known_N[is_held, 1])


def shear_gain(read_N: np.ndarray, known_N: np.ndarray) -> float:
    """Return the ratio of spreads: of the anchor's shear (n,) in N over the new finger's.

    Both readings are noisy: a regression would shrink the gain by the new finger's noise.

    Raises ContractError: too few frames, shear that hardly changes, or fingers that disagree.
    """
    do = "Grasp the tool with both fingers and wipe, pressing lightly and firmly."
    if len(known_N) < FEWEST_HELD:
        came = f"{len(known_N)} in which the anchor feels more than {HELD_N} N"
        raise ContractError(expected("moments of wiping", f"at least {FEWEST_HELD}", came, do))
    known_sd_N = float(known_N.std())
    read_sd_N = max(float(read_N.std()), 1e-9)
    if known_sd_N < LEAST_SPREAD_N:
        wanted = f"{LEAST_SPREAD_N} N of spread or more"
        raise ContractError(expected("shear of the anchor", wanted, f"{known_sd_N:.2f} N", do))
    covariance = ((known_N - known_N.mean()) * (read_N - read_N.mean())).mean()
    r = float(covariance / (known_sd_N * read_sd_N))
    gain = known_sd_N / read_sd_N
    if r < LEAST_R or not GAINS[0] <= gain <= GAINS[1]:
        wanted = (
            f"one that follows the anchor's, r ≥ {LEAST_R}, by a gain of {GAINS[0]} to {GAINS[1]}"
        )
        came = f"r {r:.2f}, gain {gain:.2f}"
        do = "Are both sensors mounted upright?"
        raise ContractError(expected("shear of the new sensor", wanted, came, do))
    return gain


def _gain(known_N: np.ndarray, read_N: np.ndarray, do: str) -> float:
    """Return the gain that brings readings (n,) to known loads (n,).

    Raises ContractError: they don't follow.
    """
    gain = float((known_N * read_N).sum() / max(float((read_N**2).sum()), 1e-9))
    rest_N = float(np.sqrt(((gain * read_N - known_N) ** 2).mean()))
    if not GAINS[0] <= gain <= GAINS[1] or rest_N > REST_SHARE * known_N.mean():
        came = f"{np.round(read_N, 1).tolist()} N read of {known_N.tolist()}"
        wanted = f"readings that follow the loads, by a gain of {GAINS[0]} to {GAINS[1]}"
        raise ContractError(expected("presses", wanted, came, do))
    return gain


def _gain_alone(
    z: torch.Tensor,
    head: ForceHead,
    new: str,
    anchor: str,
    gain: float,
    through_tool: bool = False,
) -> Calibration:
    """Return a calibration whose map is the identity."""
    return Calibration(
        map=LatentMap(*z.shape[1:]).eval(),
        tokenizer_hash=head.tokenizer_hash,
        head_hash=head.hash,
        new=new,
        anchor=anchor,
        ridge=0.0,
        turn_deg=0.0,
        agreement={},
        gain=gain,
        through_tool=through_tool,
    )


def _newtons(head: ForceHead, z: Latent) -> np.ndarray:
    return head(z).double().numpy()
