"""Where a live view goes: the terminal, a window, rerun, or a picture file."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import cv2
import numpy as np

from uniforce_cli.rerun_viewer import import_rerun, open_viewer
from uniforce_cli.touch_live import TouchView
from uniforce_vtla.errors import ContractError, expected

SHADES = " .:-=+*#%@"
TEXT_SIDE = 7  # the terminal's map has 7×7 characters
FULL_NORM = 3.0  # a latent that far from free air is drawn at full brightness
FULL_COUNTS = 4000  # normal counts of a taxel at full brightness: a few newtons on it
PANEL_PX = 480
OUTPUTS = ("terminal", "window", "rerun")


class Output(Protocol):
    """Takes views until it is closed."""

    is_open: bool

    def show(self, view: TouchView) -> None:
        """Show one view."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def make_output(name: str) -> Output:
    """Return the output called ``name``.

    Raises:
        ContractError: unknown, or it can't work here: no display, rerun not installed.
    """
    if name == "terminal":
        return Terminal()
    if name == "window":
        return Window()
    if name == "rerun":
        return Rerun()
    raise ContractError(expected("output", " | ".join(OUTPUTS), name, "Choose one."))


class _Open:
    is_open = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.is_open = False


class Terminal(_Open):
    """Numbers, and a small map in characters; on a real terminal each view replaces the last."""

    def __init__(self) -> None:
        self._lines = 0

    def show(self, view: TouchView) -> None:
        """Print one view."""
        text = as_text(view)
        if sys.stdout.isatty() and self._lines:
            text = f"\x1b[{self._lines}F\x1b[J{text}"  # back to the top of the last one, and clear it
        print(text, flush=True)
        self._lines = text.count("\n") + 1


class Window(_Open):
    """An OpenCV window; q or Esc closes it."""

    def __init__(self) -> None:
        do = "Use output=terminal, or output=rerun."
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise ContractError(expected("window", "a display", "none", do))
        try:
            cv2.namedWindow("touch")
        except cv2.error as error:
            came = "a headless build (the project's own dependency)"
            raise ContractError(expected("OpenCV", "one with windows", came, do)) from error

    def show(self, view: TouchView) -> None:
        """Draw one view."""
        cv2.imshow("touch", panel(view))
        self.is_open = cv2.waitKey(1) & 0xFF not in (ord("q"), 27)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        cv2.destroyWindow("touch")


class Rerun(_Open):
    """The rerun viewer, if the user has it; it isn't among the project's dependencies."""

    def __init__(self) -> None:
        self._rerun = import_rerun("output=rerun", "output=terminal")
        self._rerun.init("uniforce touch")
        open_viewer()
        self._rerun.connect_grpc()

    def show(self, view: TouchView) -> None:
        """Log one view."""
        rr = self._rerun
        rr.log("markers", rr.Image(view.markers))
        rr.log("latent_norm", rr.Image(_grey(view.norms)))
        rr.log("raw", rr.Image(raw_picture(view)))
        for name, newtons in zip("xyz", () if view.force_N is None else view.force_N, strict=False):
            rr.log(f"force_N/{name}", rr.Scalars(float(newtons)))
        rr.log("age_ms", rr.Scalars(view.age_ms))


def as_text(view: TouchView) -> str:
    """Return a view as text: rate, age, force, what the sensor shows, and the map of latent lengths."""
    force = "no head" if view.force_N is None else " ".join(f"{f:+6.2f}" for f in view.force_N) + " N"
    head = (
        f"{view.label}: {view.rate_hz:6.1f} Hz, age {view.age_ms:6.1f} ms, lost {view.lost}\n"
        f"force x y z {force}   latent up to {view.norms.max():.2f}"
    )
    raw = _counts_text(view.raw) if view.raw.ndim == 2 else [f"mean grey {view.raw.mean():.0f}"]
    rows = [row + "   " + extra for row, extra in _side_by_side(_map_text(view.norms), raw)]
    return "\n".join([head, *rows])


def _map_text(norms: np.ndarray) -> list[str]:
    small = cv2.resize(norms.astype(np.float32), (TEXT_SIDE, TEXT_SIDE), interpolation=cv2.INTER_AREA)
    shade = np.clip(small / FULL_NORM * (len(SHADES) - 1), 0, len(SHADES) - 1).round().astype(int)
    return ["|" + "".join(SHADES[s] * 2 for s in row) + "|" for row in shade]


def _counts_text(counts: np.ndarray) -> list[str]:
    """Return the normal counts as the pad shows them: the first taxel is at the bottom left."""
    grid = counts[:, 2].reshape(4, 4)[::-1]
    return ["z counts", *(" ".join(f"{z:6d}" for z in row) for row in grid)]


def _side_by_side(left: list[str], right: list[str]) -> list[tuple[str, str]]:
    length = max(len(left), len(right))
    return list(zip(left + [""] * (length - len(left)), right + [""] * (length - len(right)), strict=True))


def panel(view: TouchView) -> np.ndarray:
    """Return (480, W, 3) uint8 BGR: raw, markers and latent lengths side by side, with the numbers above."""
    raw = cv2.cvtColor(raw_picture(view), cv2.COLOR_RGB2BGR)
    raw = cv2.resize(raw, (raw.shape[1] * PANEL_PX // raw.shape[0], PANEL_PX))
    markers = cv2.cvtColor(view.markers, cv2.COLOR_GRAY2BGR)
    grey = cv2.resize(_grey(view.norms), (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_NEAREST)
    picture = np.concatenate([raw, markers, cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)], axis=1)
    for i, line in enumerate(as_text(view).splitlines()[:2]):
        cv2.putText(picture, line, (10, 20 + 20 * i), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 200, 255), 1)
    return picture


def raw_picture(view: TouchView) -> np.ndarray:
    """Return the raw signal as (H, W, 3) uint8 RGB; taxels as a 4×4 picture of their normal counts."""
    return view.raw if view.raw.ndim == 3 else counts_picture(view.raw)


def counts_picture(change: np.ndarray) -> np.ndarray:
    """Return (120, 160, 3) uint8 RGB of (16, 3) counts above the reference: normal counts, upright."""
    z = np.clip(change[:, 2].reshape(4, 4)[::-1] / FULL_COUNTS * 255, 0, 255).astype(np.uint8)
    return np.repeat(cv2.resize(z, (160, 120), interpolation=cv2.INTER_NEAREST)[..., None], 3, axis=2)


def save_panel(view: TouchView, path: str) -> Path:
    """Write the panel as a picture file; return its path.

    Raises:
        ContractError: OpenCV can't write there, or not that kind of file.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        written = cv2.imwrite(str(target), panel(view))
    except cv2.error:
        written = False
    if not written:
        raise ContractError(expected("save", "a writable .png or .jpg", path, "Name another file."))
    return target


def _grey(norms: np.ndarray) -> np.ndarray:
    return np.clip(norms / FULL_NORM * 255, 0, 255).astype(np.uint8)
