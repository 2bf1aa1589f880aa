"""Checks of a tactile sensor.

How fast and fresh it is, which way up it sits on its finger, and at what angle.

Each raises SensorError where the sensor dies meanwhile. One more looks at recorded films: where are
they free of touch?
"""

import time
from collections.abc import Callable, Sequence
from itertools import product

import cv2
import numpy as np

from uniforce_robots.sensors.config_uniforce import TURNS, Orientation
from uniforce_robots.sensors.finger import TactileFinger
from uniforce_vtla.contracts import QUARTERS
from uniforce_vtla.sensors import get_sensor
from uniforce_vtla.tokenizer.descriptor import describe

WAIT_MS = 1000.0
PRESSED_COUNTS = 400.0  # summed over a quarter's taxels; a light touch gives 300 on one
PRESSED_SHARE = 0.01  # of a quarter's pixels that changed
RELEASED = 0.5  # of those: the finger is off again
POLL_S = 0.004
DRAGGED_PX = 1.5  # mean motion of the markers that counts as a drag
ANGLE_DEG = 5.0  # a hand drags no straighter


def check_rate(finger: TactileFinger, seconds: float) -> int:
    """Print rate, losses, and ages at random moments beside an idle loop's lateness.

    1 if anything was lost or bad.
    """
    before = finger.counts
    first = finger.latest(WAIT_MS).index
    rng = np.random.default_rng(0)
    ages_ms = []
    late_ms = []
    start_s = time.monotonic()
    while time.monotonic() < start_s + seconds:
        pause_s = POLL_S * rng.uniform(0.5, 1.5)  # at no fixed phase to the samples
        asleep_s = time.perf_counter()
        time.sleep(pause_s)
        late_ms.append(1e3 * (time.perf_counter() - asleep_s - pause_s))
        ages_ms.append(finger.latest(WAIT_MS).age_ms)
    spent_s = time.monotonic() - start_s
    age_p50, age_p99 = np.percentile(ages_ms, [50, 99])
    idle_p50, idle_p99 = np.percentile(late_ms, [50, 99])
    lost = finger.counts.lost - before.lost
    bad = finger.counts.bad - before.bad
    samples = finger.latest(WAIT_MS).index - first
    idle = f"an idle loop here wakes late by p50 {idle_p50:.2f}, p99 {idle_p99:.2f} ms"
    print(finger.config.label)
    print(f"rate {samples / spent_s:.1f} Hz over {samples} samples, lost {lost}, bad {bad}")
    print(f"age p50 {age_p50:.2f} ms, p99 {age_p99:.2f} ms ({idle})")
    settings = [f"{name} {value:g}" for name, value in finger.settings_read_back.items()]
    if settings:
        print(f"settings, read back: {', '.join(settings)}")
    return int(lost + bad > 0)


def check_orientation(finger: TactileFinger, asked: Sequence[str], seconds: float) -> int:
    """Have each quarter in ``asked`` pressed, within ``seconds`` each; print which one moved.

    0 if all agree.
    """
    print("Look at the pad with the fingertip up, and press where asked, alone and gently.")
    seen: dict[str, str] = {}
    for quarter in asked:
        print(f"press the {quarter} of the pad …", flush=True)
        response = _next_response(finger, seconds, lambda response: response.max() >= 1)
        if response is None:
            print(f"  nothing measured within {seconds:g} s")
            return 1
        pressed = seen[quarter] = QUARTERS[int(response.argmax())]
        verdict = "as asked" if pressed == quarter else "NOT as asked"
        print(f"  measured at the {pressed}{_strongest_taxel(finger)}: {verdict}")
        _next_response(finger, seconds, lambda response: response.max() < RELEASED)
    if all(quarter == moved for quarter, moved in seen.items()):
        print("orientation agrees")
        return 0
    print(advice(seen, finger.config.orientation.rotation_deg, finger.config.orientation.flip))
    return 1


def check_angle(finger: TactileFinger, seconds: float) -> int:
    """Have the skin dragged towards the fingertip, once; print the angle on the mount.

    0 if it is set right.
    """
    print(
        "Press a fingertip on the pad, drag the skin straight to the sensor's tip, then let go.",
        flush=True,
    )
    moved_px = _longest_drag(finger, seconds)
    if moved_px is None:
        print(f"  nothing was dragged within {seconds:g} s")
        return 1
    off_deg = off_upwards_deg(moved_px)
    print(
        f"  markers moved by {np.hypot(*moved_px):.1f} px, "
        f"{off_deg:+.0f}° off the fingertip's direction"
    )
    if abs(off_deg) <= ANGLE_DEG:
        print("angle agrees")
        return 0
    now_deg = finger.config.rotation_deg
    step = 90 if get_sensor(finger.config.sensor).signal == "taxel" else 1
    print(
        f"angle does not agree: set rotation_deg={round((now_deg - off_deg) / step) * step % 360}"
    )
    return 1


def off_upwards_deg(moved_px: np.ndarray) -> float:
    """Return the angle of (dx, dy), y down, from straight up.

    Counter-clockwise as the image shows it, ±180.
    """
    return float((np.degrees(np.arctan2(-moved_px[1], moved_px[0])) - 90 + 180) % 360 - 180)


def _longest_drag(finger: TactileFinger, seconds: float) -> np.ndarray | None:
    """Return the mean motion (2,) px of the markers where one drag was longest.

    None where none came in time.
    """
    index = -1
    end_s = time.monotonic() + seconds
    best: np.ndarray = np.zeros(2)
    reference = finger.reference_image()[..., 0]
    while time.monotonic() < end_s:
        touch = finger.next_touch(index, WAIT_MS)
        index = touch.index
        moved = describe(reference, finger.marker_image(touch.raw)[None])[0, :2]
        length = np.hypot(*moved)
        longest = np.hypot(*best)
        if length > longest:
            best = moved
        if longest >= DRAGGED_PX and length < RELEASED * DRAGGED_PX:
            return best
    return None


def _next_response(
    finger: TactileFinger, seconds: float, wanted: Callable[[np.ndarray], bool]
) -> np.ndarray | None:
    """Return the first (4,) response of the quarters that is ``wanted``.

    None where none came in time.
    """
    index = -1
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        touch = finger.next_touch(index, WAIT_MS)
        index = touch.index
        response = quarter_response(finger, touch.raw)
        if wanted(response):
            return response
    return None


def quarter_response(finger: TactileFinger, raw: np.ndarray) -> np.ndarray:
    """Return (4,) how much each of ``QUARTERS`` moved since the reference.

    1 = counts as pressed.
    """
    if raw.ndim == 2:
        rise = np.maximum(raw.astype(np.int64) - finger.reference_raw, 0)[:, 2].reshape(4, 4)[::-1]
        scale = PRESSED_COUNTS
    else:
        rise = cv2.absdiff(finger.marker_image(raw), finger.reference_image()[..., 0]) / 255.0
        scale = PRESSED_SHARE * rise.size / 4
    height, width = rise.shape
    # row by row
    return rise.reshape(2, height // 2, 2, width // 2).sum(axis=(1, 3)).ravel() / scale


def advice(seen: dict[str, str], rotation_deg: float, flip: bool) -> str:
    """Return what to set, given asked → measured quarters under the present orientation."""
    if rotation_deg or flip:
        return (
            "orientation does not agree: run this check again with rotation_deg=0 flip=false "
            "to learn what to set"
        )
    measured = np.array(QUARTERS).reshape(2, 2)
    fits = []
    for mirror, turn in product((False, True), TURNS):
        mount = Orientation(turn, mirror)
        shown = dict(zip(QUARTERS, mount.of_frame(measured).flat, strict=True))
        if seen.items() <= shown.items():
            fits.append(mount)
    if not fits:
        return "orientation does not agree, and no turn explains this"
    if len(fits) > 1:
        came = "several turns explain this: press all four quarters"
        return f"orientation does not agree, and {came}"
    setting = f"rotation_deg={fits[0].rotation_deg} flip={str(fits[0].flip).lower()}"
    return f"orientation does not agree: set {setting}"


def _strongest_taxel(finger: TactileFinger) -> str:
    raw = finger.latest(WAIT_MS).raw
    if raw.ndim != 2:
        return ""
    rise = (raw.astype(np.int64) - finger.reference_raw)[:, 2]
    return f", most at taxel {int(rise.argmax()) + 1} ({int(rise.max()):+d} counts)"
