"""Does the latent hold force (the paper's Q1), and does it redraw what the other finger saw (Q2)?  Unseen indenters."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.latent_rotation import fit_rotation, pad_latent
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.contact.indenters import UNSEEN
from uniforce_vtla.contact.pairs import PairSettings, equilibrium_pairs
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.pair_cache import shrink

SOURCE = "tactip"  # the sensor of both pretraining rigs; its labels fit the one rotation
RIGS = (("gelsight", "tactip"), ("uskin", "tactip"), ("gelsight_d", "tactip"))  # the last one in no pretraining
PAIRS_SEED = 7_003
BRANCHES = ((0, 0), (1, 1), (1, 0), (0, 1))  # (whose latent, whose picture)


def latent_correlation(tokenizer: Tokenizer, table: Table) -> dict[str, Any]:
    """Return |r| of the rotated pad latent's axes with Fx, Fy, Fz per sensor, and of hand descriptors turned alike.

    One rotation, fitted to the source's training set; the axes stand for the same forces on every sensor.
    """

    def per_sensor(features: Any) -> dict[str, list[float]]:
        turned = fit_rotation(features(table.training[SOURCE]), table.training[SOURCE].force_N, SOURCE)
        return {
            name: _abs_r(turned(features(labelled)), labelled.force_N).tolist()
            for name, labelled in table.frozen.items()
        }

    found = {"latent": per_sensor(lambda s: pad_latent(tokenizer, s)), "hand_descriptor": per_sensor(_descriptor)}
    return {"what": "simulated; |r| of Fx, Fy, Fz with their axes, unseen indenters", "source": SOURCE, "abs_r": found}


def _descriptor(labelled: LabelledSet) -> np.ndarray:
    return labelled.descriptor.astype(np.float64) / np.asarray(NATURAL_UNITS)


def _abs_r(z: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Return (3,) |r| of the first three of (n, T, L) latents with (n, T, 3) forces."""
    flat, force = z.reshape(-1, z.shape[-1]), force_N.reshape(-1, 3)
    return np.array([abs(np.corrcoef(flat[:, k], force[:, k])[0, 1]) for k in range(3)])


@torch.no_grad()
def reconstructions(tokenizer: Tokenizer, pairs: int, picture: Path) -> dict[str, Any]:
    """Return grey-level errors of the four branches beside copying the reference, and draw each rig's median pair."""
    found: dict[str, Any] = {"what": "simulated pairs, unseen indenters and units; mean |grey error| over copying's"}
    rows, side = [], tokenizer.config.side
    for left, right in RIGS:
        rng = np.random.default_rng(PAIRS_SEED)
        settings = PairSettings(pairs_per_unit=4)
        batch = equilibrium_pairs(rng, pairs, left, right, UNSEEN, settings, lambda images: shrink(images, side))
        before = [_model_input(batch.left_reference, "left"), _model_input(batch.right_reference, "right")]
        after = [_model_input(batch.left_current, "left"), _model_input(batch.right_current, "right")]
        z = [tokenizer.model.encoder(b, a).mean for b, a in zip(before, after, strict=True)]
        drawn = {(i, j): tokenizer.model.decoder(before[j], z[i]) for i, j in BRANCHES}
        copied = [(before[j] - after[j]).abs().mean(dim=(1, 2, 3)) for j in range(2)]
        errors = {way: (said - after[way[1]]).abs().mean(dim=(1, 2, 3)) for way, said in drawn.items()}
        names = {f"{'LR'[i]}->{'LR'[j]}": float(e.mean() / copied[j].mean()) for (i, j), e in errors.items()}
        found[f"{left}+{right}"] = names | {
            "cross_over_self": [float(errors[1 - j, j].mean() / errors[j, j].mean()) for j in range(2)]
        }
        median = int(np.argsort((errors[1, 0] + errors[0, 1]).numpy())[pairs // 2])
        rows.append([*(p[median, 0] for j in range(2) for p in (before[j], after[j], drawn[j, j], drawn[1 - j, j]))])
    _draw(rows, picture)
    return found


def _model_input(images: np.ndarray, finger: Any) -> torch.Tensor:
    return to_canonical(torch.from_numpy(images)[:, None].float() / 255, finger)


def _draw(rows: list[list[torch.Tensor]], path: Path) -> None:
    titles = [f"{side} {what}" for side in "LR" for what in ("reference", "current", "own latent", "other's latent")]
    figure = Figure(figsize=(2 * len(titles), 1.7 * len(rows) + 0.5), layout="constrained")
    grid = figure.subplots(len(rows), len(titles), squeeze=False)
    for line, images, rig in zip(grid, rows, RIGS, strict=True):
        for axes, image, title in zip(line, images, titles, strict=True):
            axes.imshow(image.numpy(), cmap="gray", vmin=0, vmax=1)
            axes.set(xticks=[], yticks=[], title=title)
        line[0].set_ylabel(" + ".join(rig))
    save_figure(figure, path)
