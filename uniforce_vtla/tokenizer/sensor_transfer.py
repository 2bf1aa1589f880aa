"""Maps between the pooled latents of two fingers of a grasp, whatever sensors they wear, and the noise around them.

One frozen tokenizer encodes every sensor, but two fingers of one grasp don't give the same latents: sensors are encoded
a little differently, and the fingers share the grasp's force, not its torsion. Grasps are simulated and need no label,
so how much fingers differ is known before a policy is trained (``benchmarks.sensor_transfer``). A policy can't lean on
what only its own finger shows if a part of its demos is mapped to another finger's latents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.latent import MOST_DIRECTIONS
from uniforce_vtla.tokenizer.weights import checkpoint_folder, load_model, read_config, save_checkpoint

FOLDER = "transfer"  # beside a shipped tokenizer's folder, inside one given by path
# amplitude beyond which the noise grows no further: no grasp that maps were fitted on is much larger
LARGEST = 2.0
MAX_KINDS, MAX_NUMBERS = 16, 1024  # larger files are none of ours
EARLIER_NAMES = {"doubt": "noise_scale"}  # of tensors, in files of version 0.1.0


class SensorTransfer(nn.Module):
    """z of a source sensor → matrix · z + offset + amplitude(z) · noise_scale · noise, for every source and target.

    Friction bounds torsion and side force by the press, so fingers differ the more the harder they press: the noise is
    that of an average grasp's amplitude, and there is none in free air.

    Attributes:
        kinds: sensors' names; their places are the indices below.
        matrix, noise_scale: (S, S, n, n) by source and target, n = grid² · latent; ``noise_scale`` is lower-triangular.
        offset: (S, S, n).
        rest: (S, n) latents of a source in free air.
        unit: (S, n) what a number is divided by for the amplitude: its spread times the average grasp's amplitude.
        directions: (n, MOST_DIRECTIONS) on which all sensors agree, best first, of spread 1 over grasps.
        origin: (MOST_DIRECTIONS,) the latents of free air along them.
        disagreement: (MOST_DIRECTIONS,) spread of the fingers of one grasp along them.
    """

    matrix: Tensor
    noise_scale: Tensor
    offset: Tensor
    rest: Tensor
    unit: Tensor
    directions: Tensor
    origin: Tensor
    disagreement: Tensor

    def __init__(self, kinds: Sequence[str], numbers: int, tokenizer_hash: str = "") -> None:
        super().__init__()
        if not 1 <= len(kinds) <= MAX_KINDS or not 1 <= numbers <= MAX_NUMBERS:
            came = f"{len(kinds)} sensors, {numbers} numbers"
            do = "Fit it again with python -m benchmarks.sensor_transfer."
            raise CheckpointError(expected("transfer", f"up to {MAX_KINDS}, {MAX_NUMBERS}", came, do))
        self.kinds, self.tokenizer_hash = tuple(kinds), tokenizer_hash
        square, most = (len(kinds), len(kinds), numbers, numbers), min(MOST_DIRECTIONS, numbers)
        zeros = {"matrix": square, "noise_scale": square, "offset": square[:3], "rest": square[1:3]}
        for name, shape in {**zeros, "directions": (numbers, most), "origin": (most,)}.items():
            self.register_buffer(name, torch.zeros(shape))
        self.register_buffer("unit", torch.ones(square[1:3]))
        self.register_buffer("disagreement", torch.ones(most))

    def row(self, source: str) -> int:
        """Return the index of a source sensor; raises ContractError: a sensor these maps don't know."""
        if source not in self.kinds:
            do = "Fit it with python -m benchmarks.sensor_transfer, or train with policy.augment.sensor_transfer=0."
            raise ContractError(expected("sensor of the demos", " | ".join(self.kinds), repr(source), do))
        return self.kinds.index(source)

    def mapped(self, z: Tensor, row: int, target: int, noise: float = 1.0) -> Tensor:
        """Return latents of a finger with the sensor ``target``, drawn at random, for z (B, n) of the sensor ``row``.

        ``noise`` scales what is drawn: 0 gives the expected latents, 1 the whole spread.
        """
        # (B, 1)
        amplitude = ((z - self.rest[row]) / self.unit[row]).square().mean(dim=1, keepdim=True).sqrt()
        drawn = torch.randn_like(z) @ self.noise_scale[row, target].T
        expected_z = z @ self.matrix[row, target].T + self.offset[row, target]
        return expected_z + noise * amplitude.clamp(max=LARGEST) * drawn

    @classmethod
    def from_pretrained(cls, tokenizer: str | Path | None, tokenizer_hash: str) -> SensorTransfer:
        """Load the maps that belong to a tokenizer: shipped ("small", None or "nano"), or a folder's own.

        Raises:
            CheckpointError: none there, damaged, not of this form, or made for a tokenizer of another hash.
        """
        folder = checkpoint_folder(tokenizer, FOLDER)
        folder = folder if folder.name == FOLDER else folder / FOLDER
        facts = read_config(folder)
        try:
            kinds, numbers = [str(kind) for kind in facts["kinds"]], int(facts["numbers"])
            made_for = str(facts["tokenizer_hash"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            do = "Fit it again with python -m benchmarks.sensor_transfer."
            raise CheckpointError(expected(str(folder), "kinds, numbers, hash", error, do)) from error
        if made_for != tokenizer_hash:
            do = "Run python -m benchmarks.sensor_transfer for this tokenizer."
            raise CheckpointError(expected("tokenizer of the maps", tokenizer_hash, made_for, do))
        return load_model(folder, lambda: cls(kinds, numbers, tokenizer_hash), EARLIER_NAMES)

    def save(self, folder: str | Path, facts: Mapping[str, Any]) -> Path:
        """Write maps and what they were fitted on to a folder that ``from_pretrained`` finds."""
        own = {"kinds": self.kinds, "numbers": self.offset.shape[-1], "tokenizer_hash": self.tokenizer_hash}
        return save_checkpoint(Path(folder), self, {**facts, **own})
