"""A recorded episode as a page: one HTML file with a slider, which any browser shows without a network."""

import json
from base64 import b64encode
from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from uniforce_cli.episode_films import Films
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.episode_summary import (
    FORCES,
    LETTERS,
    EpisodeSummary,
    TimeLine,
    draw_channels,
    draw_key_frames,
    draw_timeline,
)

# a page that can load nothing and can't send anything, whatever a dataset says of itself
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 1rem auto; max-width: 1260px; padding: 0 10px; }
h1 { font-size: 1.4rem; margin: 0 0 .3rem; } h2 { font-size: 1.1rem; margin: 1.6rem 0 .2rem; }
img { display: block; max-width: 100%; height: auto; } p { color: #444; max-width: 68rem; margin: .2rem 0 .5rem; }
dl { display: flex; flex-wrap: wrap; gap: .2rem 1.6rem; margin: .3rem 0; } dt { color: #666; } dl div { display: flex; }
dd { margin: 0 0 0 .4rem; }
.verdict { background: #f3f1ee; border-left: 4px solid #6a4c93; padding: .4rem .8rem; margin: .5rem 0; }
#player { position: sticky; top: 0; z-index: 1; background: #fff; padding: .4rem 0; border-bottom: 1px solid #ccc; }
#films { display: flex; gap: 6px; } figure { margin: 0; flex: 1; min-width: 0; max-width: 260px; }
figcaption { font-size: 13px; color: #444; }
figure img { width: 100%; height: 200px; object-fit: contain; background: #000; }
#frame { margin: .5rem 0 0; } #controls { display: flex; gap: .5rem; align-items: center; }
#events { flex: 1; max-height: 3.4rem; overflow-y: auto; }
#time { font-size: 1.2rem; font-weight: 600; min-width: 4.8rem; } #number { color: #666; margin-right: .5rem; }
button { font: inherit; font-size: 13px; border: 1px solid #bbb; border-radius: 3px; background: #fff; }
button.beyond { border-color: #e63946; color: #b3202c; } [aria-pressed=true] { background: #222; color: #fff; }
button.beyond[aria-pressed=true] { background: #e63946; color: #fff; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }
th { font-weight: 400; color: #666; } th, td { padding: 0 .9rem 0 0; text-align: right; min-width: 4.2rem; }
#readout { display: flex; align-items: end; gap: 1rem; margin-top: .2rem; }
#press { padding: .1rem .5rem; border-radius: 3px; background: #eee; }
#press.inside { background: #d4edea; } #press.outside { background: #fbdcdf; }
#plot { position: relative; cursor: crosshair; }
#cursor { position: absolute; top: 0; bottom: 0; border-left: 2px solid #222; }
"""
HONEST = (
    "Forces are estimates, read from marker images; nothing else measured them."
    " x runs along the pad's columns, y down its rows, z into the pad, in the left finger's frame for both."
)
TRUE = " Pale, broad lines are the simulator's true forces."
CLICK = " A click on the time line moves the slider."
TOUCH = (
    "Markers: cyan where they are in free air, red where they are now, white where both."
    " Latent: how far each patch's latent force is from free air, brighter is further, as the sensor sees it;"
    " one scale per finger."
)
CHANNELS = "Every channel of the latent where both fingers hold hardest: what a policy's force tokens are made of."


def write_sheet(summary: EpisodeSummary, films: Films, facts: Mapping[str, str], folder: Path, stem: str) -> Path:
    """Write the page with all of its pictures in it, and the still ones beside it too; return the page's path.

    ``facts`` are the lines at the top; whatever they hold is shown as text, never as HTML.
    """
    # where both fingers together press hardest
    held = max(summary.key_frames, key=lambda moment: float(summary.force_N[moment.frame, :, 2].sum()))
    line = draw_timeline(summary, folder / f"{stem}_timeline.png")
    moments = draw_key_frames(summary, folder / f"{stem}_moments.png")
    latent = draw_channels(summary, held, folder / f"{stem}_latent.png")
    values = _values(summary)
    honest = HONEST + (TRUE if summary.true_force_N is not None else "") + CLICK
    body = [
        f"<h1>{escape(summary.title)}</h1>",
        "<dl>" + "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in facts.items()) + "</dl>",
        f'<div class="verdict">{_verdict(summary)}</div>',
        _player(summary, films, line, list(values)),
        f'<h2>Time line</h2>\n<p>{escape(honest)}</p>\n<div id="plot">{_still(line.path)}<div id="cursor"></div></div>',
        f"<h2>Key frames</h2>\n<p>{escape(TOUCH)}</p>\n{_still(moments)}",
        f"<h2>Latent force, {escape(held.name)}</h2>\n<p>{escape(CHANNELS)}</p>\n{_still(latent)}",
        f'<script type="application/json" id="data">{_data(summary, films, line, values)}</script>',
        f'<script type="module">\n{Path(__file__).with_name("episode_page.js").read_text()}</script>',
    ]
    page = folder / f"{stem}.html"
    page.write_text(
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>{escape(summary.title)}</title><style>{STYLE}</style></head><body>\n{'\n'.join(body)}\n</body></html>\n"
    )
    return page


def _verdict(summary: EpisodeSummary) -> str:
    verdict = f"<b>Estimated from the fingers:</b> {escape('; '.join(summary.verdict))}"
    if summary.true_verdict:
        verdict += f"<br><b>The same from true forces:</b> {escape('; '.join(summary.true_verdict))}"
    return verdict


def _player(summary: EpisodeSummary, films: Films, line: TimeLine, rows: list[str]) -> str:
    """Return what moves: pictures, slider, events and numbers."""
    pictures = "".join(
        f'<figure><img id="{escape(name)}" alt="{escape(says)}"><figcaption>{escape(says)}</figcaption></figure>'
        for name, says in ((name, _caption(name)) for name in films.pictures)
    )
    last, heads = len(summary.time_s) - 1, [f"{finger} {name}" for finger in FINGERS for name, _ in FORCES]
    heads = ["press on board"] * (summary.found is not None) + heads
    table = f"<tr><th></th>{''.join(f'<th>{head} [N]</th>' for head in heads)}</tr>"
    table += "".join(f'<tr id="{row}"><th>{row}</th>{"<td></td>" * len(heads)}</tr>' for row in rows)
    # as wide as the plots below it, and half a knob more on both sides
    place = f"margin-left: calc({line.left:.2%} - 8px); width: calc({line.right - line.left:.2%} + 16px)"
    press = '<span id="press"></span>' * (summary.found is not None)
    return (
        f'<div id="player"><div id="films">{pictures}</div>\n'
        f'<input id="frame" type="range" min="0" max="{last}" value="0" aria-label="frame" style="{place}">\n'
        f'<div id="controls"><button id="play">Play</button><span id="time"></span><span id="number"></span>'
        f'<span id="events">{_events(summary)}</span></div>\n'
        f'<div id="readout"><table>{table}</table>{press}</div></div>'
    )


def _caption(stream: str) -> str:
    kind, _, name = stream.partition("/")
    return f"{name} camera" if kind == "camera" else f"{name} finger, {kind}"


def _events(summary: EpisodeSummary) -> str:
    """Return a button for each key frame, and for each stretch beyond a limit."""
    events = [(f"{a} {k.name}", k.frame, k.frame + 1, "") for a, k in zip(LETTERS, summary.key_frames, strict=False)]
    events += [(stretch.name, stretch.first, stretch.end, "beyond") for stretch in summary.stretches]
    return " ".join(
        f'<button class="{kind}" data-first="{first}" data-end="{end}">'
        f"{escape(name)}, {summary.time_s[first]:.1f} s</button>"
        for name, first, end, kind in events
    )


def _values(summary: EpisodeSummary) -> dict[str, np.ndarray]:
    """Return (n, columns) newtons by row of the table: press where it is known, then both fingers."""
    rows = {}
    kinds = (("estimate", summary.force_N, summary.found), ("true", summary.true_force_N, summary.truth))
    for name, force_N, judged in kinds:
        if force_N is not None:
            press = [] if judged is None else [judged.press_N[:, None]]
            rows[name] = np.concatenate([*press, force_N.reshape(len(force_N), -1)], axis=1)
    return rows


def _data(summary: EpisodeSummary, films: Films, line: TimeLine, values: dict[str, np.ndarray]) -> str:
    """Return what the page's script reads; see there."""
    limits = ScoreLimits()
    content = {
        "frames": films.frames,
        "pictures": {name: [b64encode(p).decode() for p in film] for name, film in films.pictures.items()},
        "values": {row: numbers.round(2).tolist() for row, numbers in values.items()},
        "time_s": summary.time_s.round(3).tolist(),
        "plot": [line.left, line.right],
        "press": None if summary.found is None else {"band_N": limits.band_N, "wiping_N": limits.wiping_press_N},
    }
    return json.dumps(content, allow_nan=False).replace("<", "\\u003c")  # names of cameras are a dataset's own


def _still(picture: Path) -> str:
    return f'<img src="data:image/png;base64,{b64encode(picture.read_bytes()).decode()}" alt="{escape(picture.stem)}">'
