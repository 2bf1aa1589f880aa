"""A recorded episode for the rerun viewer: every stream on one time line, in one .rrd file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from uniforce_cli.recorded_episode import camera_frames, cameras, raw_touch
from uniforce_datasets.source import Episode, Source
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary
from uniforce_vtla.keys import tactile_key

TIME = "time"
AXES = ("fx", "fy", "fz")
JPEG_QUALITY = 85  # of scene cameras and raw tactile frames
HEAT_PX = 16  # a patch's side in a heat map, so that the viewer has something to show


def write_recording(
    rerun: ModuleType, summary: EpisodeSummary, source: Source, episode: Episode, path: Path
) -> Path:
    """Write an episode and the layout it is looked at in.

    Args:
        rerun: the package.
        summary: forces, latents and verdict.
        source: where the pictures are.
        episode: which one.
        path: of the .rrd file.

    Raises:
        DatasetError: a video that is missing or truncated.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with rerun.RecordingStream("uniforce show", recording_id=path.stem) as recording:
        recording.save(path, default_blueprint=_layout(rerun, summary, cameras(source)))
        recording.log("events", rerun.TextDocument("\n".join(["estimated:", *summary.verdict])), static=True)
        for name, key in cameras(source).items():
            pictures = (_encoded(frame, ".jpg") for frame in camera_frames(source, episode, key))
            _send_pictures(rerun, recording, f"camera/{name}", "image/jpeg", pictures, summary)
        for finger in FINGERS:
            _send_touch(rerun, recording, summary, source, episode, finger)
        _send_numbers(rerun, recording, summary)
    return path


def _send_touch(
    rerun: ModuleType, recording: Any, summary: EpisodeSummary, source: Source, episode: Episode, finger: Any
) -> None:
    if (raw := raw_touch(source, episode, finger)) is not None:
        frames = (_encoded(frame, ".jpg") for frame in raw())
        _send_pictures(rerun, recording, f"raw/{finger}", "image/jpeg", frames, summary)
    images = camera_frames(source, episode, tactile_key(finger))
    markers = (_encoded(frame[..., 0], ".png") for frame in images)
    _send_pictures(rerun, recording, f"markers/{finger}", "image/png", markers, summary)
    strength = summary.strength(finger)
    scale = 255 / max(float(strength.max()), 1e-6)
    heat = (_encoded(_heat(frame * scale), ".png") for frame in strength)
    _send_pictures(rerun, recording, f"latent/{finger}", "image/png", heat, summary)


def _send_pictures(
    rerun: ModuleType,
    recording: Any,
    path: str,
    kind: str,
    pictures: Iterator[bytes],
    summary: EpisodeSummary,
) -> None:
    blobs = list(pictures)
    columns = rerun.EncodedImage.columns(blob=blobs, media_type=[kind] * len(blobs))
    recording.send_columns(path, [rerun.TimeColumn(TIME, duration=summary.time_s)], columns)


def _send_numbers(rerun: ModuleType, recording: Any, summary: EpisodeSummary) -> None:
    for path, values in traces(summary).items():
        columns = rerun.Scalars.columns(scalars=np.ascontiguousarray(values))
        recording.send_columns(path, [rerun.TimeColumn(TIME, duration=summary.time_s)], columns)
    for stretch in summary.stretches:
        for frame, word in ((stretch.first, "begins"), (stretch.end - 1, "ends")):
            recording.set_time(TIME, duration=summary.time_s[frame])
            recording.log("log", rerun.TextLog(f"{stretch.name} {word}", level="WARN"))
    for key_frame in summary.key_frames:
        recording.set_time(TIME, duration=summary.time_s[key_frame.frame])
        recording.log("log", rerun.TextLog(key_frame.name, level="INFO"))


def traces(summary: EpisodeSummary) -> dict[str, np.ndarray]:
    """Return (n,) numbers by path: forces of both fingers, and what follows from them."""
    found = {}
    for number, finger in enumerate(FINGERS):
        for axis, name in enumerate(AXES):
            found[f"force_N/{finger}/{name}_estimate"] = summary.force_N[:, number, axis]
            if summary.true_force_N is not None:
                found[f"force_N/{finger}/{name}_true"] = summary.true_force_N[:, number, axis]
    for word, judged in (("estimate", summary.found), ("from_true_forces", summary.truth)):
        if judged is not None:
            found[f"press_N/{word}"] = judged.press_N
            found |= (
                {f"friction_used/{word}": judged.friction_used.min(axis=1)} if summary.judges_slip else {}
            )
    return found


def _layout(rerun: ModuleType, summary: EpisodeSummary, seen: dict[str, str]) -> Any:
    blueprint = rerun.blueprint
    pictures = [f"camera/{name}" for name in seen]
    touch = [f"raw/{finger}" for finger in summary.key_frames[0].raw]
    touch += [f"{what}/{finger}" for what in ("markers", "latent") for finger in FINGERS]
    plots = [f"force_N/{finger}" for finger in FINGERS]
    plots += ["press_N"] if summary.found is not None else []
    plots += ["friction_used"] if summary.found is not None and summary.judges_slip else []
    texts = (blueprint.TextDocumentView(origin="events"), blueprint.TextLogView(origin="log"))
    return blueprint.Blueprint(
        blueprint.Horizontal(
            blueprint.Vertical(
                blueprint.Grid(*(blueprint.Spatial2DView(origin=path, name=path) for path in pictures)),
                blueprint.Grid(*(blueprint.Spatial2DView(origin=path, name=path) for path in touch)),
            ),
            blueprint.Vertical(
                *(blueprint.TimeSeriesView(origin=path, name=path) for path in plots),
                blueprint.Horizontal(*texts),
            ),
        )
    )


def _heat(strength: np.ndarray) -> np.ndarray:
    large = np.kron(np.clip(strength, 0, 255).astype(np.uint8), np.ones((HEAT_PX, HEAT_PX), np.uint8))
    return cv2.cvtColor(cv2.applyColorMap(large, cv2.COLORMAP_MAGMA), cv2.COLOR_BGR2RGB)


def _encoded(picture: np.ndarray, ending: str) -> bytes:
    image = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else picture
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if ending == ".jpg" else []
    return cv2.imencode(ending, image, options)[1].tobytes()
