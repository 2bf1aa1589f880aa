"""What a wrong data sheet costs: a new camera's px/mm stated too high or too low, and force read all the same.

Marker images are brought to nominal scale by the px/mm a sensor's facts state (markers/nominal_scale.py). Here the
statement is wrong by a known factor; heads and tokenizer know nothing of it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch.nn import functional as F  # noqa: N812

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import POOL, Table, encode_set, learnt_row, transfer_name
from benchmarks.probes.zero_shot_figure import AXES
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.tokenizer.api import Tokenizer

STATED = (0.6, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.25, 1.4, 1.6)  # stated px/mm over the true one


def scale_error(tokenizer: Tokenizer, table: Table, seeds: int) -> dict[str, Any]:
    """Return per scored sensor R² of Fx, Fy, Fz over ``STATED``, each the mean over sources."""
    frozen = {
        _key(sensor, stated): rescaled(labelled, 1 / stated)
        for sensor, labelled in table.frozen.items()
        for stated in STATED
    }
    row = learnt_row(replace(table, frozen=frozen), lambda s: encode_set(tokenizer, s), seeds, POOL)
    found = {
        sensor: [
            np.mean(
                [row[transfer_name(source, _key(sensor, stated))]["r2"] for source in table.training], axis=0
            ).tolist()
            for stated in STATED
        ]
        for sensor in table.frozen
    }
    return {"stated_over_true": list(STATED), "r2": found}


def rescaled(labelled: LabelledSet, zoom: float) -> LabelledSet:
    """Return the set with its small pictures zoomed about their centre, cut or padded with black."""
    frames = labelled.frames  # (n, T, S, S)
    flat = frames.reshape(-1, *frames.shape[-2:])
    return replace(
        labelled,
        reference=_zoomed(labelled.reference, zoom),
        frames=_zoomed(flat, zoom).reshape(frames.shape),
    )


def _zoomed(images: np.ndarray, zoom: float) -> np.ndarray:
    if zoom == 1:
        return images
    side = images.shape[-1]
    pictures = torch.from_numpy(images).float()[:, None]
    size = max(1, round(side * zoom))
    zoomed = F.interpolate(pictures, (size, size), mode="bilinear", antialias=zoom < 1, align_corners=False)
    margin = side - size
    before = margin // 2  # negative margins cut
    framed = F.pad(zoomed, (before, margin - before, before, margin - before))
    return framed[:, 0].round().to(torch.uint8).numpy()


def _key(sensor: str, stated: float) -> str:
    return f"{sensor} at {stated:g}"


def draw_scale_error(content: dict[str, Any], path: Path) -> Path:
    """Draw R² of each axis over the stated scale, a line per sensor; return the picture's path."""
    stated = np.array(content["stated_over_true"])
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    for axis, panel in enumerate(figure.subplots(1, 3, sharey=True)):
        for sensor, r2 in content["r2"].items():
            panel.plot(stated, np.array(r2)[:, axis], "o-", ms=4, label=sensor)
        panel.axvline(1.0, color="0.5", lw=0.8, ls="--")
        panel.set(title=AXES[axis], xlabel="px/mm as stated over true", ylim=(-0.6, 1.02))
        panel.grid(alpha=0.25)
    figure.axes[0].set_ylabel("R², mean over sources")
    figure.axes[0].legend(fontsize=8)
    figure.suptitle(f"Cameras outside the training, their scale misstated ({content['set']}, simulated)")
    return save_figure(figure, path)
