"""A recorded episode as a page: one HTML file with a slider, for any browser, without a network."""

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
    """Write the page with all of its pictures, and the time line beside it; return the page's path.

    ``facts`` are the lines at the top; they are shown as text, never as HTML.
    """
    line = draw_timeline(summary, folder / f"{stem}_timeline.png")
    heads = []
    if summary.found is not None:
        heads.append("press on board")
    for finger in FINGERS:
        heads += [f"{finger} {name}" for name, _ in FORCES]
    # words, first frame, the one after the last, and kind
    events = []
    for letter, moment in zip(LETTERS, summary.key_frames, strict=False):
        events.append((f"{letter} {moment.name}", moment.frame, moment.frame + 1, ""))
    for stretch in summary.stretches:
        events.append((stretch.name, stretch.first, stretch.end, "beyond"))
    text = TEMPLATES.get_template("episode_page.html").render(
        summary=summary,
        facts=facts,
        line=line,
        heads=heads,
        captions={name: _caption(name) for name in films.pictures},
        events=events,
        data=_data(summary, films, line),
    )
    page = folder / f"{stem}.html"
    page.write_text(text)
    return page


def _caption(stream: str) -> str:
    kind, _, name = stream.partition("/")
    if kind == "camera":
        return f"{name} camera"
    return f"{name} finger, {kind}"


def _values(summary: EpisodeSummary) -> dict[str, list[list[float]]]:
    """Return n rows of newtons by row of the table: press where it is known, then both fingers."""
    rows = {}
    for name, force_N, judged in (
        ("estimate", summary.force_N, summary.found),
        ("true", summary.true_force_N, summary.truth),
    ):
        if force_N is not None:
            columns = [force_N.reshape(len(force_N), -1)]
            if judged is not None:
                columns.insert(0, judged.press_N)
            rows[name] = np.column_stack(columns).round(2).tolist()
    return rows


def _data(summary: EpisodeSummary, films: Films, line: TimeLine) -> dict[str, Any]:
    """Return the data that the page's script reads; see there."""
    limits = ScoreLimits()
    pictures = {}
    for name, film in films.pictures.items():
        pictures[name] = [b64encode(picture).decode() for picture in film]
    press = None
    if summary.found is not None:
        press = {"band_N": limits.band_N, "wiping_N": limits.wiping_press_N}
    return {
        "frames": films.frames,
        "pictures": pictures,
        "values": _values(summary),
        "time_s": summary.time_s.round(3).tolist(),
        "plot": [line.left, line.right],
        "press": press,
    }
