"""One look at a finger, newest sample through canonicalizer, tokenizer and force head.

And where it is shown.
"""

import importlib
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from uniforce_robots.sensors.finger import TactileFinger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.markers.mirror import to_canonical

WAIT_MS = 1000.0
SHADES = " .:-=+*#%@"
TEXT_SIDE = 7  # the terminal's map has 7×7 characters
FULL_NORM = 3.0  # a latent that far from free air is drawn at full brightness
FULL_COUNTS = 4000  # normal counts of a taxel at full brightness: a few newtons on it
PANEL_PX = 480


@dataclass(frozen=True)
class TouchView:
    """Pictures and numbers shown of one sample."""

    label: str  # which sensor on which finger
    raw: np.ndarray  # (H, W, 3) uint8 RGB, or (16, 3) int64 counts above the reference
    markers: np.ndarray  # (480, 640) uint8 marker image, as the sensor sees it
    # (g, g) float32, length of each patch's latent minus its free-air latent, as the sensor sees it
    norms: np.ndarray
    force_N: np.ndarray | None  # (3,) in the finger's own frame, image axes; None without a head
    age_ms: float  # how old the sample was when it was looked at
    rate_hz: float  # measured
    lost: int  # samples so far


def views(finger: TactileFinger, sensor: ForceSensor, label: str) -> Iterator[TouchView]:
    """Yield a view of each new sample of a connected finger that has its reference.

    Raises ContractError: a finger without reference; SensorError: no new sample.
    """
    reference = np.ascontiguousarray(finger.reference_image()[..., 0])
    tokenizer = sensor.tokenizer
    free = tokenizer.encode(reference, reference, sensor.finger)
    grid = math.isqrt(tokenizer.num_patches)
    index = -1
    while True:
        touch = finger.next_touch(index, WAIT_MS)
        index = touch.index
        markers = finger.marker_image(touch.raw)
        change = tokenizer.encode(reference, markers, sensor.finger) - free  # (1, P, L)
        norms = change.norm(dim=-1).numpy().reshape(grid, grid)
        raw = touch.raw
        if raw.ndim == 2:  # counts mean little without their rest
            raw = raw.astype(np.int64) - finger.reference_raw
        force_N = None
        if sensor.head is not None:
            force_N = sensor.read_markers(reference, markers).force_N
        yield TouchView(
            label=label,
            raw=raw,
            markers=markers,
            norms=to_canonical(norms, sensor.finger),  # undoes the mirror
            force_N=force_N,
            age_ms=touch.age_ms,
            rate_hz=finger.rate_hz,
            lost=finger.counts.lost,
        )


def _terminal() -> Callable[[TouchView], None]:
    """Print numbers and a small map in characters.

    On a real terminal each view replaces the last.
    """
    lines = 0

    def show(view: TouchView) -> None:
        nonlocal lines
        text = as_text(view)
        to_top_and_clear = f"\x1b[{lines}F\x1b[J" if sys.stdout.isatty() and lines else ""
        print(to_top_and_clear + text, flush=True)
        lines = text.count("\n") + 1

    return show


def _rerun() -> Callable[[TouchView], None]:
    """Log into the rerun viewer; ContractError: the extra ``rerun`` isn't installed.

    The viewer outlives this program and listens on loopback: rerun's own ``spawn`` listens on every
    interface of the machine.
    """
    try:
        rerun = importlib.import_module("rerun")
    except ImportError as error:
        do = "Run `pip install '.[rerun]'`, or use output=terminal."
        wanted = "the package rerun-sdk"
        raise ContractError(expected("output=rerun", wanted, "none", do)) from error
    rerun.init("uniforce touch")
    viewer = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1"]
    subprocess.Popen(viewer, start_new_session=True)
    rerun.connect_grpc()

    def show(view: TouchView) -> None:
        rerun.log("markers", rerun.Image(view.markers))
        rerun.log("latent_norm", rerun.Image(_grey(view.norms)))
        rerun.log("raw", rerun.Image(raw_picture(view)))
        if view.force_N is not None:
            for name, newtons in zip("xyz", view.force_N, strict=True):
                rerun.log(f"force_N/{name}", rerun.Scalars(float(newtons)))
        rerun.log("age_ms", rerun.Scalars(view.age_ms))

    return show


OUTPUTS = {"terminal": _terminal, "rerun": _rerun}


def as_text(view: TouchView) -> str:
    """Return a view as text.

    Rate, age, force, what the sensor shows, and the map of latent lengths.
    """
    force = "no head"
    if view.force_N is not None:
        x, y, z = view.force_N
        force = f"{x:+6.2f} {y:+6.2f} {z:+6.2f} N"
    head = [
        f"{view.label}: {view.rate_hz:6.1f} Hz, age {view.age_ms:6.1f} ms, lost {view.lost}",
        f"force x y z {force}   latent up to {view.norms.max():.2f}",
    ]
    raw = [f"mean grey {view.raw.mean():.0f}"]
    # normal counts as the pad shows them: the first taxel is at the bottom left
    if view.raw.ndim == 2:
        raw = ["z counts"]
        for row in view.raw[:, 2].reshape(4, 4)[::-1]:
            raw.append("{:6d} {:6d} {:6d} {:6d}".format(*row))
    small = cv2.resize(
        view.norms.astype(np.float32), (TEXT_SIDE, TEXT_SIDE), interpolation=cv2.INTER_AREA
    )
    shade = np.clip(small / FULL_NORM * (len(SHADES) - 1), 0, len(SHADES) - 1).round().astype(int)
    lines = list(head)
    raw += [""] * (TEXT_SIDE - len(raw))
    for row, extra in zip(shade, raw, strict=True):
        drawn = "".join(SHADES[s] * 2 for s in row)
        lines.append(f"|{drawn}|   {extra}")
    return "\n".join(lines)


def panel(view: TouchView) -> np.ndarray:
    """Return (480, W, 3) uint8 BGR.

    Raw, markers and latent lengths side by side, with the numbers above.
    """
    raw = cv2.cvtColor(raw_picture(view), cv2.COLOR_RGB2BGR)
    raw = cv2.resize(raw, (raw.shape[1] * PANEL_PX // raw.shape[0], PANEL_PX))
    markers = cv2.cvtColor(view.markers, cv2.COLOR_GRAY2BGR)
    grey = cv2.resize(_grey(view.norms), (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_NEAREST)
    picture = np.concatenate([raw, markers, cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)], axis=1)
    for i, line in enumerate(as_text(view).splitlines()[:2]):
        cv2.putText(
            picture, line, (10, 20 + 20 * i), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 200, 255), 1
        )
    return picture


def raw_picture(view: TouchView) -> np.ndarray:
    """Return the raw signal as (H, W, 3) uint8 RGB.

    Taxels as a 4×4 picture of their normal counts.
    """
    return view.raw if view.raw.ndim == 3 else counts_picture(view.raw)


def counts_picture(change: np.ndarray) -> np.ndarray:
    """Return (120, 160, 3) uint8 RGB of (16, 3) counts above the reference.

    Normal counts, upright.
    """
    z = np.clip(change[:, 2].reshape(4, 4)[::-1] / FULL_COUNTS * 255, 0, 255).astype(np.uint8)
    large = cv2.resize(z, (160, 120), interpolation=cv2.INTER_NEAREST)
    return cv2.cvtColor(large, cv2.COLOR_GRAY2RGB)


def save_panel(view: TouchView, path: str) -> Path:
    """Write the panel as a picture file; return its path.

    Raises ContractError: OpenCV can't write there, or not that kind.
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
