"""Save figures."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DPI = 90  # legible on a screen, small in a repository


def save_figure(figure: Figure, path: Path, dpi: int = DPI, crop: bool = False) -> Path:
    """Save without pyplot's global state, so that any thread or process may draw; return ``path``.

    Args:
        figure: what was drawn.
        path: of the picture; its folder is made.
        dpi: pixels per inch of the figure's size.
        crop: cut white margins off, and keep what lies outside the figure.
    """
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi, bbox_inches="tight" if crop else None)
    return path
