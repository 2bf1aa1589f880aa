"""How fast raw signals become marker images, beside what OpenCV alone needs for the plainest segmentation.

One thread, in its CPU time, so that other programs on the machine don't enter. Cameras are timed as a control loop
uses them: ``pair`` with one reference and a new current frame each time. Frames are synthetic, 640×480, with noise,
uneven light and the sensor's own marker layout.
"""

import time
from collections.abc import Callable
from itertools import cycle

import cv2
import numpy as np

from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.sensors import SensorSpec, get_sensor, list_sensors

FRAMES = 8  # different current frames, so that nothing can be remembered
NOISE_LEVELS = 3.0  # grey levels, as small CMOS cameras have
WARM_UP = 3  # calls before the clock starts


def bench_canonicalizer(seconds: float) -> dict[str, dict]:
    """Return canonicalisation rates and an anchor measured in the same run, Hz on one thread.

    Args:
        seconds: time to spend in all.

    Returns:
        ``canonicalize_hz``: median rate per sensor; ``first_frame_hz``: the same when the way to see the markers has
        to be found in every frame (cameras only); ``anchors``: adaptiveThreshold + connectedComponents on a grey frame.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return _bench(seconds / (2 * len(list_sensors())))
    finally:
        cv2.setNumThreads(threads)


def synthetic_frame(spec: SensorSpec, rng: np.random.Generator, shift_px: float = 0.0) -> np.ndarray:
    """Return an (480, 640, 3) uint8 frame with the sensor's layout: bright pins on a dome, dark squares on a gel."""
    rows, columns = spec.raw_shape[:2]
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    dome = spec.dome_radius_mm is not None
    light = 1 - 0.4 * ((x / columns - 0.5) ** 2 + (y / rows - 0.5) ** 2)
    colour = np.array([20, 22, 28] if dome else [170, 190, 150], np.float32)
    ink = np.array([120, 140, 180] if dome else [-130, -140, -110], np.float32)
    frame = light[..., None] * (colour + ink * _marker_cover(spec, shift_px)[..., None])
    return np.clip(frame + rng.normal(0, NOISE_LEVELS, frame.shape), 0, 255).astype(np.uint8)


def canonicalizer_rate(name: str, rng: np.random.Generator, seconds: float) -> float:
    """Return how many raw signals of a sensor become marker images per second of one thread's CPU time."""
    return _rate(_pair_call(name, rng), seconds)


def _bench(seconds_each: float) -> dict[str, dict]:
    rng = np.random.default_rng(0)
    steady = {name: canonicalizer_rate(name, rng, seconds_each) for name in list_sensors()}
    cameras = [name for name in list_sensors() if get_sensor(name).signal == "camera"]
    first = {name: _rate(_first_frame_call(name, rng), seconds_each) for name in cameras}
    anchor = _rate(_anchor_call(rng), seconds_each)
    return {"canonicalize_hz": steady, "first_frame_hz": first, "anchors": {"adaptive_threshold_hz": anchor}}


def _pair_call(name: str, rng: np.random.Generator) -> Callable[[], object]:
    canon, spec = Canonicalizer(name), get_sensor(name)
    if spec.signal == "camera":
        reference = synthetic_frame(spec, rng)
        currents = cycle([synthetic_frame(spec, rng, shift_px=1.0 + i / FRAMES) for i in range(FRAMES)])
        return lambda: canon.pair(reference, next(currents), "left")
    counts = rng.integers(16_000, 38_000, spec.raw_shape)
    canon.set_reference(counts)
    loads = cycle([counts + rng.integers(0, 4_000, spec.raw_shape) for _ in range(FRAMES)])
    return lambda: canon.marker_image(next(loads))


def _first_frame_call(name: str, rng: np.random.Generator) -> Callable[[], object]:
    frame = synthetic_frame(get_sensor(name), rng)
    return lambda: Canonicalizer(name).marker_image(frame)


def _anchor_call(rng: np.random.Generator) -> Callable[[], object]:
    gray = cv2.cvtColor(synthetic_frame(get_sensor("gelsight"), rng), cv2.COLOR_RGB2GRAY)
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


def _marker_cover(spec: SensorSpec, shift_px: float) -> np.ndarray:
    """Return (480, 640) float32: 1 on markers, soft at their edges."""
    rows, columns = spec.raw_shape[:2]
    cover = np.zeros((rows, columns), np.float32)
    centres = spec.layout_mm * np.asarray(spec.px_per_mm) + (columns / 2 + shift_px, rows / 2)
    half = spec.marker_size_mm * spec.px_per_mm[0] / 2
    for x, y in centres:
        if spec.marker_shape == "square":
            corners = [(round(x - half), round(y - half)), (round(x + half), round(y + half))]
            cv2.rectangle(cover, corners[0], corners[1], 1.0, cv2.FILLED)
        else:
            cv2.circle(cover, (round(x), round(y)), round(half), 1.0, cv2.FILLED)
    return cv2.GaussianBlur(cover, (0, 0), 1.0)
