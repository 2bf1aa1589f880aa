"""The alignment that controls get: the same grasps and the same map, for what no force head reads."""

import sys
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from uniforce_cli.boundary import command, one_thread
from uniforce_cli.calibrate import Unit
from uniforce_cli.paired_grasps import simulated_grasps
from uniforce_vtla.contracts import Finger
from uniforce_vtla.options import Count, OutFolder, Seed, TokenizerFolder
from uniforce_vtla.tokenizer import Latent, Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent_map import fit_map
from uniforce_vtla.tokenizer.plain_touch import descriptors


@dataclass
class AlignCommand:
    """Fit the map of ``uniforce calibrate`` to hand descriptors, or to a tokenizer without heads.

    Example: python -m benchmarks.ladder.align feature=descriptor new=uskin:2 out=outputs/maps/descriptor/uskin-2
    """

    feature: Literal["descriptor", "latent"] = "descriptor"
    new: Unit = "uskin:2"
    anchor: Unit = "tactip:1"
    grasps: Count = 600
    tokenizer: TokenizerFolder = ""  # feature=latent; empty = shipped
    out: OutFolder = "outputs/maps/descriptor/uskin-2"
    seed: Seed = 0  # of the grasps


def described(reference: np.ndarray, current: np.ndarray, finger: Finger) -> Latent:
    """Return hand descriptors (B, 1, 6), in the place of pooled latents."""
    return torch.from_numpy(descriptors(reference, current, finger))[:, None]  # type: ignore[return-value]


@command(AlignCommand)
def main(config: AlignCommand) -> None:
    one_thread()
    tokenizer = (
        Tokenizer.from_pretrained(config.tokenizer or None) if config.feature == "latent" else None
    )
    encode = tokenizer.pooled if tokenizer else described
    made_for = tokenizer.hash if tokenizer else config.feature
    grasps = simulated_grasps(config.new, config.anchor, config.grasps, config.seed, encode)
    new, anchor = (z.as_subclass(torch.Tensor) for z in (grasps.new, grasps.anchor))
    order = torch.randperm(len(new), generator=torch.Generator().manual_seed(config.seed))
    fitted, ridge = fit_map(new[order], anchor[order])
    left = float((fitted(new) - anchor).square().mean() / (new - anchor).square().mean())
    found = Calibration(fitted, made_for, "", config.new, config.anchor, ridge, 0.0, {})
    where = found.save(config.out)
    print(
        f"{config.feature} of {config.new}: {left:.2f} of the squared difference is left; map in {where}"
    )


if __name__ == "__main__":
    sys.exit(main())
