"""The demo's one picture page: what each sensor sees, how an episode went, what was scored."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure, SubFigure
from matplotlib.image import imread

from uniforce_vtla.contact import TactileSimulator, gap_map
from uniforce_vtla.contracts import ContactState, MarkerPair
from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.evaluation.pictures import PICTURE_DPI, draw_outcomes
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.raster import overlay
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

PRESS_N = (1.5, 1.0, 6.0)  # the one force all three sensors are shown under


def draw_demo_page(reports: Sequence[ArmReport], sheet: Path, path: Path) -> Path:
    """Draw the page; ``sheet`` is the filmed episode's picture."""
    figure = Figure(figsize=(16, 12), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 1.5], squeeze=False)[:, 0]
    _draw_sensors(top)
    left, right = bottom.subplots(1, 2, width_ratios=[1.7, 1])
    left.imshow(imread(sheet))
    left.axis("off")
    draw_outcomes(right, reports)
    right.set_box_aspect(0.4)  # three bars don't want a whole column
    right.set_title(f"shipped policy, n = {reports[0].n} per arm: smoke, no claim")
    return save_figure(figure, path, PICTURE_DPI, crop=True)


def _draw_sensors(figure: SubFigure) -> None:
    tokenizer = Tokenizer.from_pretrained()
    columns = figure.subplots(2, len(list_sensors()), height_ratios=[2.6, 1])
    head = ForceHead.from_pretrained("tactip")
    for (above, below), sensor in zip(columns.T, list_sensors(), strict=True):
        pair = _press(sensor)
        latent = tokenizer.encode(pair)  # (1, P, 6)
        read_N = ", ".join(f"{value:+.1f}" for value in head(latent)[0].tolist())
        above.imshow(overlay(pair.reference, pair.current))
        above.set_title(f"{sensor}: reference cyan, current red\nhead trained on TacTip only: ({read_N}) N", fontsize=9)
        side = int(np.sqrt(latent.shape[1]))
        below.imshow(np.hstack(list(latent[0].numpy().T.reshape(-1, side, side))), cmap="RdBu")
        below.set_title("latent force, six channels", fontsize=9)
        above.axis("off")
        below.axis("off")
    figure.suptitle(f"one contact, true force {PRESS_N} N (simulated), as each sensor shows it", fontsize=11)


def _press(sensor: str) -> MarkerPair:
    """Press one sensor and read it the way a real one is read: raw frames through the canonicalizer."""
    gap_mm = gap_map("sphere", center_mm=(0.0, 0.0), angle_rad=0.0)[None]
    contact = ContactState(gap_mm, np.array([PRESS_N], np.float32), np.zeros(1, np.float32))
    simulator = TactileSimulator(sensor)
    return Canonicalizer(sensor).pair(simulator.raw_reference(), simulator.raw_frames(contact)[0], finger="left")
