"""How fast raw signals become marker images, beside what OpenCV alone needs for the plainest segmentation.

One thread, in its CPU time, so that other programs on the machine don't enter. Cameras are timed as a control loop
uses them: ``pair`` with one reference and a new current frame each time. Frames are those of the stand-ins, 640×480: a
ball presses and leaves.
"""

import time
from collections.abc import Callable
from itertools import cycle

import cv2
import numpy as np

from uniforce_robots.standins.scene import Scene, frame_cycle
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.sensors import get_sensor, list_sensors

FRAMES = 8  # different current frames, so that nothing can be remembered
FRAMES_hz = 10.0
ONE_PRESS = Scene(rest_s=1 / FRAMES_hz, press_s=FRAMES / FRAMES_hz)
WARM_UP = 3  # calls before the clock starts


def bench_canonicalizer(seconds: float) -> dict[str, dict]:
    """Return canonicalisation rates and an anchor measured in the same run, Hz on one thread, in ``seconds`` in all.

    ``canonicalize_hz``: median rate per sensor; ``anchors``: adaptiveThreshold + connectedComponents on a grey frame.
    """
    cv2.setNumThreads(1)
    rng, seconds_each = np.random.default_rng(0), seconds / (1 + len(list_sensors()))
    steady = {name: canonicalizer_rate(name, rng, seconds_each) for name in list_sensors()}
    anchor = _rate(_anchor_call(), seconds_each)
    return {"canonicalize_hz": steady, "anchors": {"adaptive_threshold_hz": anchor}}


def canonicalizer_rate(name: str, rng: np.random.Generator, seconds: float) -> float:
    """Return how many raw signals of a sensor become marker images per second of one thread's CPU time."""
    return _rate(_pair_call(name, rng), seconds)


def _pair_call(name: str, rng: np.random.Generator) -> Callable[[], object]:
    canon, spec = Canonicalizer(name), get_sensor(name)
    if spec.signal == "camera":
        reference, *pressed = frame_cycle(name, ONE_PRESS, FRAMES_hz)
        currents = cycle(pressed)
        return lambda: canon.pair(reference, next(currents), "left")
    free = (
        rng.integers(16_000, 38_000, spec.raw_shape)
        if spec.taxels
        else rng.normal(0, 0.01, spec.raw_shape)
    )
    loads = (
        rng.integers(0, 4_000, (FRAMES, *spec.raw_shape))
        if spec.taxels
        else rng.uniform(0, 1, (FRAMES, 1, 3))
    )
    canon.set_reference(free)
    loaded = cycle(free + load for load in loads)
    return lambda: canon.marker_image(next(loaded))


def _anchor_call() -> Callable[[], object]:
    gray = cv2.cvtColor(frame_cycle("gelsight", ONE_PRESS, FRAMES_hz)[0], cv2.COLOR_RGB2GRAY)
    method, kind = cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV
    return lambda: cv2.connectedComponents(cv2.adaptiveThreshold(gray, 255, method, kind, 39, 20))


def _rate(call: Callable[[], object], seconds: float) -> float:
    """Return 1 / the median CPU time of ``call``, Hz, from as many calls as fit into ``seconds`` of the clock."""
    for _ in range(WARM_UP):
        call()
    durations: list[float] = []
    end = time.perf_counter() + seconds
    while not durations or time.perf_counter() < end:
        start = time.thread_time()
        call()
        durations.append(time.thread_time() - start)
    return 1.0 / float(np.median(durations))
