"""The demo's one picture page: what each sensor sees, how an episode went, what was scored."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

from uniforce_vtla.contact.indenters import gap_map
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.evaluation.pictures import draw_outcomes, save_figure
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

PRESS_N = (1.5, 1.0, 6.0)  # the one force all three sensors are shown under


def draw_demo_page(reports: Sequence[ArmReport], sheet: Path, path: Path) -> Path:
    """Draw the page; ``sheet`` is the filmed episode's picture."""
    figure = Figure(figsize=(16, 13))
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 1.35])
    _draw_sensors(top)
    left, right = bottom.subplots(1, 2, width_ratios=[1.7, 1])
    left.imshow(imread(sheet))
    left.axis("off")
    draw_outcomes(right, reports)
    right.set_title(f"shipped policy, n = {reports[0].n} per arm: smoke, no claim")
    return save_figure(figure, path)


def _draw_sensors(figure: Figure) -> None:
    tokenizer = Tokenizer.from_pretrained()
    columns = figure.subplots(2, len(list_sensors()))
    for (above, below), sensor in zip(columns.T, list_sensors(), strict=True):
        reference, current = _press(sensor)
        above.imshow(np.stack([current, reference, reference], axis=-1))
        force = ForceHead.from_pretrained("tactip")(tokenizer.encode(reference, current, finger="left"))[0]
        felt = ", ".join(f"{value:+.1f}" for value in force.tolist())
        above.set_title(
            f"{sensor}: reference cyan, current red\nhead trained on TacTip only: ({felt}) N", fontsize=9
        )
        latent = tokenizer.encode(reference, current, finger="left")[0].numpy()
        side = int(np.sqrt(len(latent)))
        below.imshow(np.hstack(list(latent.T.reshape(-1, side, side))), cmap="RdBu", aspect="equal")
        below.set_title("latent force, six channels", fontsize=9)
        above.axis("off")
        below.axis("off")
    figure.suptitle(f"one contact, true force {PRESS_N} N (simulated), as each sensor shows it", fontsize=11)


def _press(sensor: str) -> tuple[np.ndarray, np.ndarray]:
    gap_mm = gap_map("sphere", center_mm=(0.0, 0.0))[None]
    contact = ContactState(gap_mm, np.array([PRESS_N], np.float32), np.zeros(1, np.float32))
    simulator = TactileSimulator(sensor)
    canonicalizer = Canonicalizer(sensor)
    pair = canonicalizer.pair(simulator.raw_reference(), simulator.raw_frames(contact)[0], finger="left")
    return pair.reference[None], pair.current[None]
