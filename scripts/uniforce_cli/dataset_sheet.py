"""A recorded episode as a page: one HTML file with a slider, which any browser shows without a network."""

from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from uniforce_cli.episode_films import Films
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.episode_summary import (
    FORCES,
    LETTERS,
    EpisodeSummary,
    TimeLine,
    draw_timeline,
)

TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True
)
TEMPLATES.policies["json.dumps_kwargs"] = {"allow_nan": False}
TEMPLATES.filters["base64"] = lambda file: b64encode(file.read_bytes()).decode()


def write_sheet(
    summary: EpisodeSummary, films: Films, facts: Mapping[str, str], folder: Path, stem: str
) -> Path:
    """Write the page with all of its pictures in it, and the time line beside it too; return the page's path.

    ``facts`` are the lines at the top; whatever they hold is shown as text, never as HTML.
    """
    line = draw_timeline(summary, folder / f"{stem}_timeline.png")
    heads = ["press on board"] * (summary.found is not None)
    heads += [f"{finger} {name}" for finger in FINGERS for name, _ in FORCES]
    # words, first frame, the one after the last, and kind
    events = [
        (f"{a} {k.name}", k.frame, k.frame + 1, "")
        for a, k in zip(LETTERS, summary.key_frames, strict=False)
    ]
    events += [
        (stretch.name, stretch.first, stretch.end, "beyond") for stretch in summary.stretches
    ]
    text = TEMPLATES.get_template("episode_page.html").render(
        **{"summary": summary, "facts": facts, "line": line, "heads": heads},
        captions={name: _caption(name) for name in films.pictures},
        events=events,
        data=_data(summary, films, line),
    )
    page = folder / f"{stem}.html"
    page.write_text(text)
    return page


def _caption(stream: str) -> str:
    kind, _, name = stream.partition("/")
    return f"{name} camera" if kind == "camera" else f"{name} finger, {kind}"


def _values(summary: EpisodeSummary) -> dict[str, np.ndarray]:
    """Return (n, columns) newtons by row of the table: press where it is known, then both fingers."""
    rows = {}
    kinds = (
        ("estimate", summary.force_N, summary.found),
        ("true", summary.true_force_N, summary.truth),
    )
    for name, force_N, judged in kinds:
        if force_N is not None:
            press = [] if judged is None else [judged.press_N[:, None]]
            rows[name] = np.concatenate([*press, force_N.reshape(len(force_N), -1)], axis=1)
    return rows


def _data(summary: EpisodeSummary, films: Films, line: TimeLine) -> dict[str, Any]:
    """Return what the page's script reads; see there."""
    limits = ScoreLimits()
    return {
        "frames": films.frames,
        "pictures": {
            name: [b64encode(p).decode() for p in film] for name, film in films.pictures.items()
        },
        "values": {row: numbers.round(2).tolist() for row, numbers in _values(summary).items()},
        "time_s": summary.time_s.round(3).tolist(),
        "plot": [line.left, line.right],
        "press": None
        if summary.found is None
        else {"band_N": limits.band_N, "wiping_N": limits.wiping_press_N},
    }
