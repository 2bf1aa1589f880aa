"""The README's moving picture: wipes by one policy whose sensor is exchanged between them, and the press below."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from uniforce_cli.score_settings import Rig
from uniforce_cli.score_worker import policy_on_rig
from uniforce_vtla.arguments import parse
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.rollout import Rollout, roll_out

MOST_BYTES = 3_000_000  # a README is read on phones, too
SHOWN = ("front", "tactile_right")


@dataclass
class MovingPictureConfig:
    """Film simulated rollouts, one per sensor on the right finger: camera, marker image, press over time.

    Example: python -m benchmarks.moving_picture right_sensors=tactip,uskin:2 out=outputs/wipe.gif
    """

    policy: str = "shipped"  # checkpoint folder
    seed: int = 30_006  # the scene, the same for every sensor; one that both wipe clean
    level: str = "touch"  # locked level
    left_sensor: str = "gelsight"  # worn on the left finger
    # worn on the right finger one after the other, comma between them
    right_sensors: str = "tactip,uskin:2"
    swap: str = ""  # e.g. touch0:left
    every: int = 3  # of the frames, one per action chunk, this many make one
    out: str = "outputs/wipe.gif"  # at most 3 MB


@dataclass(frozen=True)
class Film:
    """One rollout: what was seen at each chunk, how many steps came before it, and the scored episode."""

    sensor: str  # on the right finger
    seen: list[dict[str, np.ndarray]]
    steps: list[int]
    rollout: Rollout
    band_N: tuple[float, float]  # of the press that the task asks for


def film(config: MovingPictureConfig, right_sensor: str) -> Film:
    """Roll the scene out with that sensor on the right finger."""
    rig = Rig(config.level, config.left_sensor, right_sensor, config.swap)
    env, controller = policy_on_rig(config.policy, rig)
    seen: list[dict[str, np.ndarray]] = []
    steps: list[int] = []
    answer = controller.chunk

    def watched(observation: dict[str, Any], task: str) -> np.ndarray:
        seen.append({name: observation["pixels"][name].copy() for name in SHOWN})
        steps.append(len(env.trace.time_s))
        return answer(observation, task)

    controller.chunk = watched  # type: ignore[method-assign]
    return Film(
        right_sensor, seen, steps, roll_out(env, controller, config.seed), env.limits.band_N
    )


def draw_frames(shot: Film, config: MovingPictureConfig) -> list[Image.Image]:
    """Return one picture per kept chunk."""
    trace = shot.rollout.trace
    time_s, press_N = np.asarray(trace.time_s), np.asarray(trace.press_N)
    figure = Figure(figsize=(5.6, 3.6), dpi=80, layout="constrained")
    figure.suptitle(
        f"one policy, trained with a TacTip; now it feels with {shot.sensor}", fontsize=9
    )
    canvas = FigureCanvasAgg(figure)
    places: dict[str, Axes] = figure.subplot_mosaic(
        [SHOWN, ["press"] * len(SHOWN)], height_ratios=[3, 2], width_ratios=[3, 4]
    )
    pictures = {}
    for name, title in zip(SHOWN, ("front camera", f"what {shot.sensor} shows"), strict=True):
        places[name].axis("off")
        places[name].set_title(title, fontsize=8)
        pictures[name] = places[name].imshow(shot.seen[0][name], cmap="gray")
    axes = places["press"]
    axes.axhspan(*shot.band_N, color="#2a9d8f", alpha=0.2, lw=0)
    axes.set(
        xlim=(0, time_s[-1]), ylim=(0, max(12.0, press_N.max())), xlabel="s", ylabel="press, N"
    )
    (line,) = axes.plot([], [], color="k", lw=1)
    frames = []
    for shown, step in list(zip(shot.seen, shot.steps, strict=True))[:: config.every]:
        for name, picture in pictures.items():
            picture.set_data(shown[name])
        line.set_data(time_s[:step], press_N[:step])
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    return frames


def write_gif(path: Path, frames: Sequence[Image.Image], frame_s: float) -> Path:
    """Write the frames as an endless GIF; raises ContractError: more than ``MOST_BYTES``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    first, *rest = (frame.quantize(64) for frame in frames)
    first.save(
        path,
        save_all=True,
        append_images=rest,
        duration=round(1000 * frame_s),
        loop=0,
        optimize=True,
    )
    if path.stat().st_size > MOST_BYTES:
        came = f"{path.stat().st_size / 1e6:.1f} MB"
        raise ContractError(
            expected(str(path), "at most 3 MB", came, "Keep fewer frames: every=2.")
        )
    return path


def main(argv: list[str] | None = None) -> int:
    config = parse(MovingPictureConfig, argv)
    shots = [film(config, sensor) for sensor in config.right_sensors.split(",")]
    frames = [frame for shot in shots for frame in draw_frames(shot, config)]
    seconds = sum(float(shot.rollout.trace.time_s[-1]) for shot in shots)
    for shot in shots:
        result = shot.rollout.result
        print(
            f"{shot.sensor}: {result.outcome}, {result.metrics['in_band_share']:.0%} of the way in band"
        )
    print(f"written to {write_gif(Path(config.out), frames, seconds / len(frames))}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
