"""The README's moving picture: one scene, wiped by one policy with one sensor after the other."""

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw

from uniforce_cli.boundary import Gripper, command
from uniforce_cli.score_settings import Rig
from uniforce_cli.score_worker import policy_on_rig
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.film import FILM_HZ, film
from uniforce_vtla.evaluation.rollout import roll_out
from uniforce_vtla.options import OutFile, Policies, Seed, Text, split

MOST_MB = 3.0  # a README is read on phones, too
TITLE_PX = 18
COLOURS = 64


@dataclass
class WipeGifConfig:
    """Film one scene once per sensor of the right finger; write a GIF of at most 3 MB.

    Example: python -m benchmarks.wipe_gif sensors=tactip,uskin:2 seed=30006
    """

    policy: Policies = "shipped"
    sensors: Text = "tactip,uskin:2"  # of the right finger, comma between them
    gripper: Gripper = "hand"
    seed: Seed = 30_006  # the scene, the same for every sensor
    out: OutFile = "outputs/wipe.gif"


def titled(frame: np.ndarray, title: str) -> Image.Image:
    """Return a frame with a title above it."""
    above = np.full((TITLE_PX, frame.shape[1], 3), 255, np.uint8)
    picture = Image.fromarray(np.concatenate([above, frame]))
    ImageDraw.Draw(picture).text((4, 3), title, fill="black")
    return picture.quantize(COLOURS)


def filmed(config: WipeGifConfig, sensor: str) -> list[Image.Image]:
    """Return the frames of a rollout with that sensor, and print how it ended."""
    rig = Rig("touch", "gelsight", sensor, gripper=config.gripper)
    env, controller = policy_on_rig(config.policy, rig)
    rollout = roll_out(env, controller, config.seed, keep_shots=True)
    share = rollout.result.metrics["in_band_share"]
    print(f"{sensor}: {rollout.result.outcome}, {share:.0%} of the way within the band")
    title = f"one policy, trained with a TacTip; it feels with {sensor}"
    frames = []
    for frame in film(rollout, ScoreLimits().band_N):
        frames.append(titled(cv2.resize(frame, None, fx=0.75, fy=0.75), title))
    return frames


@command(WipeGifConfig)
def main(config: WipeGifConfig) -> None:
    frames = []
    for sensor in split(config.sensors):
        frames += filmed(config, sensor)
    path = Path(config.out)
    path.parent.mkdir(parents=True, exist_ok=True)
    first, *rest = frames
    first.save(path, save_all=True, append_images=rest, duration=round(1000 / FILM_HZ), loop=0)
    size_MB = path.stat().st_size / 1e6
    if size_MB > MOST_MB:
        do = "Film fewer sensors."
        raise ContractError(expected(str(path), "at most 3 MB", f"{size_MB:.1f} MB", do))
    print(f"written to {path}, {size_MB:.1f} MB")


if __name__ == "__main__":
    sys.exit(main())
