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
from uniforce_vtla.evaluation.rollout import Controller, Environment, Rollout, roll_out

MOST_BYTES = 3_000_000  # a README is read on phones, too
TARGET_N = 6.0  # the press demonstrations aim at
PADS = {"tactile_left": "left pad", "tactile_right": "right pad"}


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


class Watched:
    """A controller whose observations are kept."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.seen: list[dict[str, np.ndarray]] = []
        self.steps: list[int] = []

    def reset(self, env: Environment) -> None:
        """See ``Controller``."""
        self._env, self.seen, self.steps = env, [], []
        self._controller.reset(env)

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """See ``Controller``."""
        self.seen.append({name: observation["pixels"][name].copy() for name in ("front", *PADS)})
        self.steps.append(len(self._env.trace.time_s))
        return self._controller.chunk(observation, task)

    def facts(self) -> dict[str, float]:
        """See ``Controller``."""
        return self._controller.facts()


def film(config: MovingPictureConfig) -> tuple[Watched, Rollout]:
    """Roll the scene out; return what was seen at each chunk and the scored episode."""
    rig = Rig(config.level, config.left_sensor, config.right_sensor, config.swap)
    env, controller = policy_on_rig(config.policy, rig)
    watched = Watched(controller)
    return watched, roll_out(env, watched, config.seed)


def draw_frames(watched: Watched, rollout: Rollout, every: int, titles: Sequence[str]) -> list[Image.Image]:
    """Return one picture per kept chunk."""
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
        pictures[name] = places[name].imshow(watched.seen[0][name], cmap="gray")
    axes = places["press"]
    axes.axhline(TARGET_N, color="#2a9d8f", lw=0.8, ls="--")
    axes.set(xlim=(0, time_s[-1]), ylim=(0, max(12.0, press_N.max())), xlabel="s", ylabel="press, N")
    (line,) = axes.plot([], [], color="k", lw=1)
    frames = []
    for seen, step in list(zip(watched.seen, watched.steps, strict=True))[::every]:
        for name, picture in pictures.items():
            picture.set_data(seen[name])
        line.set_data(time_s[:step], press_N[:step])
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    return frames


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
    """Entry of ``python -m benchmarks.moving_picture``."""
    config = parse(MovingPictureConfig, argv)
    watched, rollout = film(config)
    titles = ("front camera", f"left pad: {config.left_sensor}", f"right pad: {config.right_sensor}")
    frames = draw_frames(watched, rollout, config.every, titles)
    frame_s = config.every * float(rollout.trace.time_s[-1]) / len(watched.seen)
    print(f"{rollout.result.outcome}: {write_gif(Path(config.out), frames, frame_s)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
