"""The pictures of docs/concepts.md: one simulated contact as three sensors show it, and the latents of each.

Example: python -m benchmarks.docs_pictures
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uniforce_vtla import ForceHead, Tokenizer, list_sensors
from uniforce_vtla.contact import ContactOptions, TactileSimulator, gap_map
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.markers.raster import overlay

OUT = Path(__file__).parents[1] / "docs" / "pictures"
# fx, fy, fz of the object on the pad: strong enough for markers to move visibly
FORCE_N = (3.0, -1.5, 8.0)
# sensor → marker images (480, 640) in free air and pressed
Images = dict[str, tuple[np.ndarray, np.ndarray]]


def draw_markers(images: Images, path: Path) -> Path:
    """Draw free air, contact and both over each other, a row per sensor."""
    figure = Figure(figsize=(8, 2.1 * len(images)), layout="constrained")
    for line, (name, pair) in zip(figure.subplots(len(images), 3), images.items(), strict=True):
        titles = (f"{name}, free air", f"{name}, pressed", "cyan: before, red: now")
        for panel, title, picture in zip(line, titles, (*pair, overlay(*pair)), strict=True):
            panel.imshow(picture, cmap="gray", interpolation="antialiased")
            panel.set(xticks=[], yticks=[], title=title)
    return save_figure(figure, path)


def draw_latents(images: Images, path: Path) -> Path:
    """Draw the numbers per patch minus those of free air, a row per sensor, and what one head reads in them."""
    tokenizer, head = Tokenizer.from_pretrained(), ForceHead.from_pretrained("tactip")
    grid, numbers = tokenizer.config.grid, tokenizer.config.latent
    figure = Figure(figsize=(9.5, 1.75 * len(images)), layout="constrained")
    for line, (name, pair) in zip(
        figure.subplots(len(images), numbers), images.items(), strict=True
    ):
        z = tokenizer.encode(pair[0][None], np.stack(pair))  # (2, P, L)
        change = (z[1] - z[0]).numpy().reshape(grid, grid, numbers)
        for k, panel in enumerate(line):
            panel.imshow(
                change[..., k], cmap="RdBu_r", vmin=-np.abs(change).max(), vmax=np.abs(change).max()
            )
            panel.set(xticks=[], yticks=[], title=f"z{k}")
        line[0].set_ylabel(name)
        line[-1].set_xlabel(
            "read: " + ", ".join(f"{newton:.1f}" for newton in head(z)[1]) + " N", loc="right"
        )
    return save_figure(figure, path)


def main() -> None:
    """Press a ball on one unit of every sensor and draw what they show."""
    press = np.array([FORCE_N], np.float32), np.zeros(1, np.float32)
    contact = ContactState(gap_map("sphere", (0.0, 0.0), 0.0)[None], *press)
    simulators = {
        name: TactileSimulator(name, options=ContactOptions().quiet()) for name in list_sensors()
    }
    images = {
        name: (one.reference(), one.marker_images(contact)[0]) for name, one in simulators.items()
    }
    print(draw_markers(images, OUT / "markers.png"), draw_latents(images, OUT / "latents.png"))


if __name__ == "__main__":
    main()
