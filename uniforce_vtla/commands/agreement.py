"""Find the directions of a tokenizer's latents on which two sensors agree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.errors import UniForceError
from uniforce_vtla.tokenizer import Tokenizer, pool_latent
from uniforce_vtla.tokenizer.agreement import Agreement, fit_agreement
from uniforce_vtla.tokenizer.pair_cache import FAMILY, LivePairs, Pairs
from uniforce_vtla.tokenizer.weights import checkpoint_folder

UNITS, CONTACTS = 16, 16  # one batch: both rigs come up, references are shared by 16 contacts


@dataclass
class AgreementCommand:
    """Find what two sensors agree on in a tokenizer's latents, from simulated equilibrium pairs and no force label.

    A small policy that listens to the first few of these directions alone runs with another sensor; the file lies in
    the tokenizer's folder and training with policy.agreed_numbers above 0 reads it.

    Example: uniforce-agreement tokenizer=outputs/small/tokenizer
    """

    tokenizer: str = "small"  # folder, or a shipped size: small | nano
    pairs: int = 8192  # grasps; two to four minutes on one core
    grid: int = 4  # latents pooled to grid × grid, as the policy's latent_grid
    seed: int = 7  # of the grasps; none of pretraining's own seeds


def _pooled(tokenizer: Tokenizer, reference: torch.Tensor, current: torch.Tensor, grid: int) -> np.ndarray:
    each = len(current) // len(reference)
    before = reference.repeat_interleave(each, dim=0)  # (n, 1, S, S)
    latent = tokenizer.model.encoder(before, current).mean  # (n, P, latent)
    return pool_latent(latent, grid).flatten(1).numpy()


def _encode(tokenizer: Tokenizer, pairs: Pairs, grid: int) -> tuple[np.ndarray, np.ndarray]:
    left = _pooled(tokenizer, pairs.left_reference, pairs.left_current, grid)
    return left, _pooled(tokenizer, pairs.right_reference, pairs.right_current, grid)


@torch.no_grad()
def find(command: AgreementCommand) -> tuple[Agreement, Path]:
    """Draw pairs, encode them, fit, and write the file; returns both."""
    folder = checkpoint_folder(command.tokenizer or None, "tokenizer")
    tokenizer = Tokenizer.from_pretrained(folder)
    rng, source = (
        np.random.default_rng([command.seed, 91]),
        LivePairs(replace(FAMILY, side=tokenizer.config.side)),
    )
    batches = -(-command.pairs // (UNITS * CONTACTS))
    found = [
        _encode(tokenizer, source.draw(rng, UNITS, CONTACTS), command.grid)
        for _ in tqdm(range(batches), desc="grasps by the 256")
    ]
    left, right = (np.concatenate(side) for side in zip(*found, strict=True))
    agreement = fit_agreement(left, right, command.grid, tokenizer.hash)
    return agreement, agreement.save(folder)


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-agreement``."""
    command = parse(AgreementCommand, argv)
    torch.set_num_threads(1)
    try:
        agreement, path = find(command)
    except UniForceError as error:
        print(f"agreement: {error}")
        return 2
    ratios = ", ".join(f"{r:.1f}" for r in agreement.ratio[:8])
    print(
        f"variance between grasps over variance between sensors, best directions first: {ratios}; in {path}"
    )
    return 0
