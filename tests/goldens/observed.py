"""Record the observations of the goldens: what a policy sees of 20 scenes at rest, holding and
wiping.

Run once: ``python tests/goldens/observed.py``. The file is input; nothing in it comes from the
chain of touch behind the marker images.
"""

from pathlib import Path

import cv2
import numpy as np

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import CAMERAS, tactile_name

FILE = Path(__file__).parent / "observed.npz"
FIRST_SEED = 20_500
# sensor on the right finger of each scene
SENSORS = ["tactip"] * 12 + ["uskin:3"] * 4 + ["gelsight:3"] * 4
MOMENTS = (0, 90, 200)  # control steps: at rest, the eraser held, wiping
SIDE_PX = 56  # of a stored camera picture


def observe(scene):
    """Return the states (3, 5), cameras (3, 2, 56, 56, 3) and marker images (3, 2, 2, 480, 640) of
    a scene."""
    env = WipeEnv("touch", right_sensor=SENSORS[scene])
    states, cameras, markers = [], [], []
    for step, _ in enumerate(walk(env, WipeExpert("right"), FIRST_SEED + scene)):
        if step not in MOMENTS:
            continue
        seen = env.observe()
        pixels = seen["pixels"]
        small = [
            cv2.resize(pixels[c], (SIDE_PX,) * 2, interpolation=cv2.INTER_AREA) for c in CAMERAS
        ]
        states.append(seen["agent_pos"])
        cameras.append(small)
        markers.append(
            [[pixels[tactile_name(f, r)][..., 0] for r in (True, False)] for f in FINGERS]
        )
        if step == MOMENTS[-1]:
            break
    return {"state": np.array(states), "camera": np.array(cameras), "marker": np.array(markers)}


def main():
    """Write the file."""
    scenes = [observe(scene) for scene in range(len(SENSORS))]
    stacked = {name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]}
    stacked["marker"] = np.packbits(stacked["marker"] > 0, axis=-1)
    np.savez_compressed(FILE, **stacked)


if __name__ == "__main__":
    main()
