"""A recorded episode as a page: pictures, and HTML that any browser shows without a network."""

from collections.abc import Mapping
from html import escape
from pathlib import Path

from uniforce_vtla.evaluation.episode_summary import EpisodeSummary, draw_channels, draw_key_frames, draw_timeline

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; margin: 2rem auto; max-width: 1280px; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
img { max-width: 100%; height: auto; } table { border-collapse: collapse; }
td { padding: .1rem 1.2rem .1rem 0; vertical-align: top; } td:first-child { color: #666; }
.verdict { background: #f3f1ee; border-left: 4px solid #6a4c93; padding: .6rem 1rem; margin: 1rem 0; }
p { color: #444; max-width: 62rem; }
"""
HONEST = (
    "Forces are estimates, read from marker images; nothing else measured them."
    " x runs along the pad's columns, y down its rows, z into the pad, in the left finger's frame for both."
)
TRUE = " Pale, broad lines are the simulator's true forces."
TOUCH = (
    "Markers: cyan where they are in free air, red where they are now, white where both."
    " Latent: how far each patch's latent force is from free air, as the sensor sees it; one scale per finger."
)
CHANNELS = "Every channel of the latent where both fingers hold hardest: what a policy's force tokens are made of."


def write_sheet(summary: EpisodeSummary, facts: Mapping[str, str], folder: Path, stem: str) -> Path:
    """Draw the pictures, write the page beside them, and return the page's path.

    ``facts`` are the lines of the table at the top; whatever they hold is shown as text, never as HTML.
    """
    # where both fingers together press hardest
    held = max(summary.key_frames, key=lambda moment: float(summary.force_N[moment.frame, :, 2].sum()))
    timeline = draw_timeline(summary, folder / f"{stem}_timeline.png")
    moments = draw_key_frames(summary, folder / f"{stem}_moments.png")
    latent = draw_channels(summary, held, folder / f"{stem}_latent.png")
    sections = (
        ("Time line", HONEST + (TRUE if summary.true_force_N is not None else ""), timeline),
        ("Key frames", TOUCH, moments),
        (f"Latent force, {held.name}", CHANNELS, latent),
    )
    rows = "\n".join(f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in facts.items())
    verdict = f"<b>Estimated from the fingers:</b> {escape('; '.join(summary.verdict))}"
    if summary.true_verdict:
        verdict += f"<br><b>The same from true forces:</b> {escape('; '.join(summary.true_verdict))}"
    body = "\n".join(
        f'<h2>{escape(title)}</h2>\n<p>{escape(text)}</p>\n<img src="{picture.name}" alt="{escape(title)}">'
        for title, text, picture in sections
    )
    page = folder / f"{stem}.html"
    page.write_text(
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(summary.title)}</title>'
        f"<style>{STYLE}</style></head><body>\n<h1>{escape(summary.title)}</h1>\n<table>{rows}</table>\n"
        f'<div class="verdict">{verdict}</div>\n{body}\n</body></html>\n'
    )
    return page
