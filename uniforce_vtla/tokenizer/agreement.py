"""The directions of pooled latents on which two sensors agree: what a policy should listen to, found without labels.

Both fingers of an equilibrium pair feel one force. Of all directions in a pooled latent, those are wanted that differ
much between grasps and little between the two sensors of a grasp: linear discriminant analysis with a grasp as the
class (Fukunaga, Introduction to Statistical Pattern Recognition, §10.2). The first three or four are force; what
follows is more and more how one kind of sensor shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors
import scipy.linalg
from safetensors.numpy import save_file

from uniforce_vtla.errors import CheckpointError, ContractError, expected

AGREEMENT = "agreement.safetensors"  # beside the weights in a tokenizer's folder
KEPT = 16  # directions stored; a policy takes the first few
SHRINKAGE = (
    0.5  # of the mean variance, added to the disagreement: cells no pair moves must not look trustworthy
)
MIN_PAIRS_PER_NUMBER = 4  # fewer grasps leave a covariance that means nothing


@dataclass(frozen=True)
class Agreement:
    """Directions on which sensors agree, best first.

    Attributes:
        directions: (K·latent, KEPT) float32; a pooled latent times one of them has unit spread over the pairs.
        ratio: (KEPT,) float32, variance between grasps over variance between the sensors of a grasp.
        grid: latents were pooled to grid × grid = K cells.
        tokenizer_hash: the tokenizer they belong to.
    """

    directions: np.ndarray
    ratio: np.ndarray
    grid: int
    tokenizer_hash: str

    def save(self, tokenizer_folder: str | Path) -> Path:
        """Write it beside the tokenizer's weights."""
        path = Path(tokenizer_folder) / AGREEMENT
        facts = {"grid": str(self.grid), "tokenizer_hash": self.tokenizer_hash}
        scratch = path.with_suffix(".part")
        save_file({"directions": self.directions, "ratio": self.ratio}, scratch, metadata=facts)
        scratch.chmod(0o644)
        return scratch.replace(path)

    @classmethod
    def load(cls, tokenizer_folder: str | Path, tokenizer_hash: str) -> Agreement:
        """Read what ``save`` wrote.

        Raises:
            CheckpointError: missing, damaged, or of another tokenizer.
        """
        path = Path(tokenizer_folder) / AGREEMENT
        do = f"Run uniforce-agreement tokenizer={tokenizer_folder}, or train with policy.agreed_numbers=0."
        if not path.is_file():
            raise CheckpointError(expected(f"agreement of {tokenizer_folder}", str(path), "no such file", do))
        try:
            with safetensors.safe_open(path, framework="numpy") as stored:
                facts = stored.metadata() or {}
                directions, ratio = stored.get_tensor("directions"), stored.get_tensor("ratio")
            grid = int(facts["grid"])
        except (safetensors.SafetensorError, KeyError, ValueError) as error:
            raise CheckpointError(expected(str(path), "directions and their facts", error, do)) from error
        fits = directions.ndim == 2 and directions.shape[1:] == ratio.shape and np.isfinite(directions).all()
        if not fits or directions.dtype != np.float32:
            came = f"{directions.dtype} {directions.shape} and {ratio.shape}"
            raise CheckpointError(expected(str(path), "(numbers, kept) finite float32", came, do))
        if facts.get("tokenizer_hash") != tokenizer_hash:
            came = str(facts.get("tokenizer_hash"))
            raise CheckpointError(expected(f"tokenizer of {path}", tokenizer_hash, came, do))
        return cls(directions, ratio, grid, tokenizer_hash)


def fit_agreement(left: np.ndarray, right: np.ndarray, grid: int, tokenizer_hash: str) -> Agreement:
    """Find the directions from paired pooled latents (n, K·latent) of the same grasps, canonical frame.

    Raises:
        ContractError: shapes that differ, NaN, too few pairs, or latents that never change.
    """
    _check(left, right)
    apart = (left - right).astype(
        np.float64
    )  # its mean stays in: a sensor's own offset is a disagreement too
    within = apart.T @ apart / len(apart) / 2
    middle = (left + right).astype(np.float64) / 2
    between = np.cov(middle.T)
    within += SHRINKAGE * np.trace(within) / len(within) * np.eye(len(within))
    ratio, directions = scipy.linalg.eigh(between, within)  # ascending
    kept = slice(None, -KEPT - 1, -1)
    best = directions[:, kept]
    best = best / (middle @ best).std(axis=0)
    # in C order: safetensors writes the bytes as they lie
    stored = (np.ascontiguousarray(array, dtype=np.float32) for array in (best, ratio[kept]))
    return Agreement(*stored, grid, tokenizer_hash)


def _check(left: np.ndarray, right: np.ndarray) -> None:
    if left.shape != right.shape or left.ndim != 2:
        came = f"{left.shape} and {right.shape}"
        raise ContractError(expected("paired latents", "(n, K·latent) twice", came, "Pair them by grasp."))
    if len(left) < MIN_PAIRS_PER_NUMBER * left.shape[1]:
        wanted = f"{MIN_PAIRS_PER_NUMBER * left.shape[1]} or more"
        raise ContractError(expected("grasps", wanted, len(left), "Draw more pairs."))
    if not (np.isfinite(left).all() and np.isfinite(right).all()):
        raise ContractError(expected("paired latents", "finite numbers", "NaN or inf", "Check the images."))
    if not np.any(left != left[0]) or not np.any(left != right):
        raise ContractError(expected("grasps", "changing latents of two sensors", "constant", "Draw others."))
