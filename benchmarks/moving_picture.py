"""The README's moving picture: one wipe, what both pads show, and the press below."""

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
TARGET_N = 6.0  # the press demonstrations aim at
PADS = ("tactile_left", "tactile_right")


@dataclass
class MovingPictureConfig:
    """Film one simulated rollout: camera, both pads' marker images, press over time.

    Example: python -m benchmarks.moving_picture seed=30001 left_sensor=uskin swap=touch0:left out=outputs/wipe.gif
    """

    policy: str = "shipped"  # checkpoint folder
    seed: int = 30_001  # the scene
    level: str = "touch"  # locked level
    left_sensor: str = "gelsight"  # worn on the left finger
    right_sensor: str = "tactip"  # worn on the right finger
    swap: str = ""  # e.g. touch0:left
    every: int = 1  # of the frames, one per action chunk, this many make one
    out: str = "outputs/wipe.gif"  # at most 3 MB


def film(config: MovingPictureConfig) -> tuple[list[dict[str, np.ndarray]], list[int], Rollout]:
    """Roll the scene out; return what was seen at each chunk, how many steps came before, and the scored episode."""
    rig = Rig(config.level, config.left_sensor, config.right_sensor, config.swap)
    env, controller = policy_on_rig(config.policy, rig)
    seen: list[dict[str, np.ndarray]] = []
    steps: list[int] = []
    answer = controller.chunk

    def watched(observation: dict[str, Any], task: str) -> np.ndarray:
        seen.append({name: observation["pixels"][name].copy() for name in ("front", *PADS)})
        steps.append(len(env.trace.time_s))
        return answer(observation, task)

    controller.chunk = watched  # type: ignore[method-assign]
    return seen, steps, roll_out(env, controller, config.seed)


def draw_frames(config: MovingPictureConfig) -> tuple[list[Image.Image], Rollout]:
    """Return one picture per kept chunk, and the episode."""
    seen, steps, rollout = film(config)
    titles = ("front camera", f"left pad: {config.left_sensor}", f"right pad: {config.right_sensor}")
    time_s, press_N = np.asarray(rollout.trace.time_s), np.asarray(rollout.trace.press_N)
    figure = Figure(figsize=(5.6, 3.5), dpi=80, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    places: dict[str, Axes] = figure.subplot_mosaic(
        [["front", "tactile_left", "tactile_right"], ["press"] * 3], height_ratios=[3, 2]
    )
    pictures = {}
    for name, title in zip(("front", *PADS), titles, strict=True):
        places[name].axis("off")
        places[name].set_title(title, fontsize=8)
        pictures[name] = places[name].imshow(seen[0][name], cmap="gray")
    axes = places["press"]
    axes.axhline(TARGET_N, color="#2a9d8f", lw=0.8, ls="--")
    axes.set(xlim=(0, time_s[-1]), ylim=(0, max(12.0, press_N.max())), xlabel="s", ylabel="press, N")
    (line,) = axes.plot([], [], color="k", lw=1)
    frames = []
    for shown, step in list(zip(seen, steps, strict=True))[:: config.every]:
        for name, picture in pictures.items():
            picture.set_data(shown[name])
        line.set_data(time_s[:step], press_N[:step])
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    return frames, rollout


def write_gif(path: Path, frames: Sequence[Image.Image], frame_s: float) -> Path:
    """Write the frames as an endless GIF; raises ContractError: more than ``MOST_BYTES``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    first, *rest = (frame.quantize(64) for frame in frames)
    first.save(path, save_all=True, append_images=rest, duration=round(1000 * frame_s), loop=0, optimize=True)
    if path.stat().st_size > MOST_BYTES:
        came = f"{path.stat().st_size / 1e6:.1f} MB"
        raise ContractError(expected(str(path), "at most 3 MB", came, "Keep fewer frames: every=2."))
    return path


def main(argv: list[str] | None = None) -> int:
    config = parse(MovingPictureConfig, argv)
    frames, rollout = draw_frames(config)
    frame_s = float(rollout.trace.time_s[-1]) / len(frames)
    print(f"{rollout.result.outcome}: {write_gif(Path(config.out), frames, frame_s)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
