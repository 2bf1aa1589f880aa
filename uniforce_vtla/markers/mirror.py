"""The one mirror: nothing else in this project flips a tactile image, a force or a contact.

Devices, datasets and the simulator store what each sensor sees. Facing fingers see a shared load
mirrored. So the tokenizer flips the right finger's image horizontally, and forces come out in that
canonical frame (the left finger's own).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uniforce_vtla.contracts import ContactState, Finger, check_finger
from uniforce_vtla.errors import ContractError, expected

if TYPE_CHECKING:
    import torch

MIRROR_FORCE = (-1.0, 1.0, 1.0)  # a horizontal flip turns x round; y and z stay


def to_canonical[Array: (np.ndarray, "torch.Tensor")](image: Array, finger: Finger) -> Array:
    """Return ``image`` (..., H, W), numpy or torch, as the left finger would see it.

    The left finger's image comes back as it is; the right finger's is flipped along its last axis.
    Applied twice it is the identity.

    Raises ContractError: unknown finger, or fewer than two axes.
    """
    if image.ndim < 2:
        raise ContractError(
            expected("image", "(..., H, W)", tuple(image.shape), "Pass whole images.")
        )
    if check_finger(finger) == "left":
        return image
    if isinstance(image, np.ndarray):
        return np.ascontiguousarray(image[..., ::-1])  # torch refuses negative strides
    return image.flip(-1)


def to_finger_frame[Array: (np.ndarray, "torch.Tensor")](force_N: Array, finger: Finger) -> Array:
    """Return force (..., 3) N from the canonical frame to the finger's own; its own inverse.

    Raises ContractError: unknown finger, a last axis other than 3, or anything but finite numbers.
    """
    shape = getattr(force_N, "shape", ())
    kind = str(getattr(force_N, "dtype", type(force_N).__name__))
    numbers = ("float", "int") if isinstance(force_N, np.ndarray) else ("torch.float",)
    if not shape or shape[-1] != 3 or not kind.startswith(numbers):
        came = f"{kind} {tuple(shape)}"
        raise ContractError(
            expected("force", "numbers (..., 3) N", came, "Pass an array of fx, fy, fz.")
        )
    finite = np.isfinite(force_N) if isinstance(force_N, np.ndarray) else force_N.isfinite()
    if not bool(finite.all()):
        raise ContractError(
            expected("force", "finite numbers", "NaN or inf", "Check what gave it.")
        )
    if check_finger(finger) == "left":
        return force_N
    if isinstance(force_N, np.ndarray):
        kept = np.result_type(force_N.dtype, np.float32)
        return (force_N * np.asarray(MIRROR_FORCE)).astype(kept)
    return force_N * force_N.new_tensor(MIRROR_FORCE)


def mirrored(contact: ContactState) -> ContactState:
    """Return the right finger's contact for the left's ``contact``, each in its own frame.

    The gap flips left-right; fx and torsion change sign.
    """
    force_N = (contact.force_N * np.asarray(MIRROR_FORCE, np.float32)).astype(np.float32)
    gap_mm = np.ascontiguousarray(contact.gap_mm[:, :, ::-1])
    return ContactState(gap_mm, force_N, -contact.torsion_Nmm)
