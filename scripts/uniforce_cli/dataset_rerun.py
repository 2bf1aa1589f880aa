"""A recorded episode for the rerun viewer: every stream on one time line, in one .rrd file."""

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from uniforce_cli.episode_films import encoded, streams
from uniforce_cli.recorded_episode import cameras, raw_touch
from uniforce_datasets.source import Episode, Source
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary

TIME = "time"
AXES = ("fx", "fy", "fz")
# for scene cameras and raw tactile frames
JPEG = (".jpg", "image/jpeg", cv2.IMWRITE_JPEG_QUALITY, 85)
PNG = (".png", "image/png")


def write_recording(
    rerun: ModuleType, summary: EpisodeSummary, source: Source, episode: Episode, path: Path
) -> Path:
    """Write an episode and its layout to an .rrd file; DatasetError for a truncated video."""
    path.parent.mkdir(parents=True, exist_ok=True)
    at = rerun.TimeColumn(TIME, duration=summary.time_s)
    with rerun.RecordingStream("uniforce show", recording_id=path.stem) as recording:
        recording.save(path, default_blueprint=_layout(rerun, summary, source, episode))
        verdict = "\n".join(["estimated:", *summary.verdict])
        recording.log("events", rerun.TextDocument(verdict), static=True)
        for name, pictures in streams(summary, source, episode):
            ending, kind, *options = JPEG if name.startswith(("camera", "raw")) else PNG
            blobs = [encoded(picture, ending, *options) for picture in pictures]
            images = rerun.EncodedImage.columns(blob=blobs, media_type=[kind] * len(blobs))
            recording.send_columns(name, [at], images)
        for name, values in traces(summary).items():
            scalars = rerun.Scalars.columns(scalars=np.ascontiguousarray(values))
            recording.send_columns(name, [at], scalars)
        for frame, text, level in _notes(summary):
            recording.set_time(TIME, duration=summary.time_s[frame])
            recording.log("log", rerun.TextLog(text, level=level))
    return path


def _notes(summary: EpisodeSummary) -> Iterator[tuple[int, str, str]]:
    """Yield frame, text and level of what happens in an episode."""
    for stretch in summary.stretches:
        yield stretch.first, f"{stretch.name} begins", "WARN"
        yield stretch.end - 1, f"{stretch.name} ends", "WARN"
    for key_frame in summary.key_frames:
        yield key_frame.frame, key_frame.name, "INFO"


def traces(summary: EpisodeSummary) -> dict[str, np.ndarray]:
    """Return (n,) numbers by path: forces of both fingers, press and used friction."""
    found = {}
    for number, finger in enumerate(FINGERS):
        for axis, name in enumerate(AXES):
            found[f"force_N/{finger}/{name}_estimate"] = summary.force_N[:, number, axis]
            if summary.true_force_N is not None:
                found[f"force_N/{finger}/{name}_true"] = summary.true_force_N[:, number, axis]
    for word, judged in (("estimate", summary.found), ("from_true_forces", summary.truth)):
        if judged is not None:
            found[f"press_N/{word}"] = judged.press_N
            if summary.judges_slip:
                found[f"friction_used/{word}"] = judged.friction_used.min(axis=1)
    return found


def _layout(rerun: ModuleType, summary: EpisodeSummary, source: Source, episode: Episode) -> Any:
    view = rerun.blueprint
    touch = []
    plots = []
    for finger in FINGERS:
        if raw_touch(source, episode, finger) is not None:
            touch.append(f"raw/{finger}")
        plots.append(f"force_N/{finger}")
    for stream in ("markers", "latent"):
        touch += [f"{stream}/{finger}" for finger in FINGERS]
    if summary.found is not None:
        plots.append("press_N")
        if summary.judges_slip:
            plots.append("friction_used")
    columns = []
    for paths in ([f"camera/{name}" for name in cameras(source)], touch):
        columns.append(view.Grid(*(view.Spatial2DView(origin=p, name=p) for p in paths)))
    texts = view.Horizontal(view.TextDocumentView(origin="events"), view.TextLogView(origin="log"))
    lines = [view.TimeSeriesView(origin=path, name=path) for path in plots]
    return view.Blueprint(view.Horizontal(view.Vertical(*columns), view.Vertical(*lines, texts)))
