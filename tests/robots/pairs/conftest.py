import numpy as np
import pytest

from uniforce_robots.pairs.pair_judge import GraspSignals
from uniforce_robots.pairs.rig import RigFrame
from uniforce_robots.pairs.storage import Pair, Session
from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE

T = 45
RATE_HZ = 15.0


@pytest.fixture
def calm():
    """A grasp in balance: closing to 6 N within a second at rest, then a slow pull of 2 N."""
    time = np.arange(T) / RATE_HZ
    led = np.clip((time - 1) / 0.3, 0, 1)
    load = np.column_stack([2 * led, -led, 6 * np.clip((time + 1 / RATE_HZ) / 0.8, 0, 1)])
    motion = np.zeros((T, 3))
    motion[:, 1] = 0.04 * led
    return GraspSignals(load, load.copy(), motion, np.zeros((T, 3)), 0.3)


def marker_image(seed):
    """A (480, 640) image of 48 dots, shifted a little by ``seed``."""
    image = np.zeros(MARKER_IMAGE_SHAPE, np.uint8)
    for row in range(40, 470, 70):
        for column in range(40, 630, 75):
            y = row + seed % 7
            x = column + seed % 5
            image[y : y + 12, x : x + 12] = 255
    return image


@pytest.fixture
def make_chunk():
    def make(indenter=0, session=0, n=3, seed=0):
        rng = np.random.default_rng(seed)
        references = {f: marker_image(100 * session + i) for i, f in enumerate(FINGERS)}

        def pair(k):
            images = {f: marker_image(seed + k + 3 * i) for i, f in enumerate(FINGERS)}
            frame = RigFrame(0, images, *rng.standard_normal((2, 3)), float(rng.uniform(1, 9)))
            force = {f: rng.uniform(0, 5, 3) for f in FINGERS}
            return Pair(frame, force, float(rng.uniform(0, 0.1)))

        return indenter, Session(session, references), [pair(k) for k in range(n)]

    return make
