"""Score recorded rollouts of a robot, which knows no truth.

Slippage, excess force and ink left, as estimates.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uniforce_cli.boundary import Head, Verify, command, one_thread
from uniforce_vtla.arguments import numbers
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import camera_key
from uniforce_vtla.options import (
    CountOrZero,
    Dataset,
    FileName,
    FolderPath,
    Numbers,
    OutFolder,
    TokenizerFolder,
)
from uniforce_vtla.results_file import provenance, write_json

if TYPE_CHECKING:
    import numpy as np

    from uniforce_datasets.source import Episode, Source
    from uniforce_vtla.evaluation.finger_estimates import FingerEstimate


@dataclass
class ScoreRecordingConfig:
    """Estimate slippage and excess force of recorded rollouts, and the ink left from a camera.

    Example: uniforce estimate root=outputs/robot pad_friction=0.6,0.7
    With the ink: board_corners=62,40,250,38,262,180,55,184
    """

    root: Dataset = "outputs/demos"  # recorded dataset, from a robot or from the simulator
    # left,right: pull slowly until the object slides, shear over grip. Needed
    pad_friction: Numbers = ""
    # x,y of the board's four corners in the camera's picture, in order around it; empty = ink isn't
    # judged
    board_corners: Numbers = ""
    camera: FileName = "front"  # scene camera that sees the board
    episodes: CountOrZero = 0  # the first so many; 0 = all
    head: Head = "tactip"  # reads newtons: a sensor kind's shipped head, or a folder
    tokenizer: TokenizerFolder = ""  # of the latents; empty = shipped
    # folder of uniforce calibrate for the left finger's sensor; empty = none
    left_calibration: FolderPath = ""
    # folder of uniforce calibrate for the right finger's sensor; empty = none
    right_calibration: FolderPath = ""
    verify: Verify = "quick"  # how the dataset is checked first
    out: OutFolder = "outputs/recording_scores"  # estimates.json


def score_recording(config: ScoreRecordingConfig) -> dict[str, Any]:
    """Return one row per episode; every number is an estimate.

    Raises ContractError: friction or corners of the wrong form; DatasetError: a dataset that can't
    be read, lacks a finger, or is truncated.
    """
    from tqdm import tqdm

    from uniforce_cli.recorded_episode import RecordingForces, finger_sensors
    from uniforce_vtla.evaluation.episode import ScoreLimits

    left, right = numbers("pad_friction", config.pad_friction, 2)
    corners = numbers("board_corners", config.board_corners, 8) if config.board_corners else None
    sensors = finger_sensors(
        config.head, config.tokenizer, config.left_calibration, config.right_calibration
    )
    recording = RecordingForces(config.root, sensors, config.verify)
    source = recording.source
    rows = []
    for episode in tqdm(
        source.episodes[: config.episodes or None], desc="episodes", unit="episode"
    ):
        forces = recording.read(episode)
        try:
            found, truth = forces.judge((left, right))
        except DatasetError as error:  # an episode that ended as it was lifted
            rows.append({"episode": episode.index, "not_judged": str(error)})
            continue
        row = _row(episode, found)
        if corners is not None:
            row["residual"] = _residual(source, episode, config.camera, corners)
        if truth is not None:
            row["with_true_forces"] = _row(episode, truth)
            row["press_mae_N"] = float(abs(found.press_N - truth.press_N).mean())
        rows.append(row)
    return {
        "what": "estimates from marker images, the robot's own height and a camera; "
        "no truth was used",
        "root": config.root,
        "read_by": {finger: sensor.facts() for finger, sensor in sensors.items()},
        "pad_friction": [left, right],
        "limits": asdict(ScoreLimits()),
        "episodes": rows,
    }


def _row(episode: Episode, found: FingerEstimate) -> dict[str, Any]:
    return {
        "episode": episode.index,
        "slippage": list(found.slippage),
        "excess_force": list(found.excess_force),
        "lost": list(found.lost),
        "press_max_N": float(found.press_N.max()),
        "in_band_share": found.in_band_share,
        "grip_mean_N": float(found.grip_N[found.press_N > 0].mean())
        if (found.press_N > 0).any()
        else 0.0,
        "friction_used_max": float(found.friction_used.min(axis=1).max()),
    }


def _residual(source: Source, episode: Episode, camera: str, corners: np.ndarray) -> dict[str, Any]:
    from uniforce_datasets.source import episode_frames
    from uniforce_vtla.evaluation.board_camera import estimate_residual

    span = episode.videos.get(camera_key(camera))
    if span is None:
        raise DatasetError(
            expected(str(source.root), camera_key(camera), "no such video", "Name another.")
        )
    first = next(episode_frames(span, 1, source.fps))
    last = next(episode_frames(span, episode.length, source.fps, first=episode.length - 1))
    try:
        found = estimate_residual(first, last, corners.reshape(4, 2))
    except DatasetError as error:  # one covered board must not cost the other episodes their scores
        return {"not_judged": str(error)}
    return {"residual": found.residual, "judged": found.judged}


def _line(row: dict[str, Any]) -> str:
    if "not_judged" in row:
        return f"episode {row['episode']}: not judged, {row['not_judged']}"
    events = [*row["lost"], *row["slippage"], *row["excess_force"]] or ["no event"]
    ink = ""
    if "residual" in row:
        left = row["residual"].get("residual")
        ink = ", ink not judged" if left is None else f", ink left {left:.0%}"
    press = f"press to {row['press_max_N']:.1f} N"
    in_band = f"{row['in_band_share']:.0%} of the way within the band"
    return f"episode {row['episode']}: {'; '.join(events)} ({press}, {in_band}{ink})"


@command(ScoreRecordingConfig)
def main(config: ScoreRecordingConfig) -> None:
    one_thread()
    content = score_recording(config)
    path = write_json(Path(config.out) / "estimates.json", content | provenance())
    print(
        "\n".join(["Estimates, not truth:", *map(_line, content["episodes"]), f"written to {path}"])
    )
    print(
        f"over time: uniforce show root={config.root} pad_friction={config.pad_friction} episode=0"
    )
