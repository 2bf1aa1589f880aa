"""Two checks of a tactile sensor: how fast and fresh it is, and which way up it sits on its finger."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from uniforce_robots.sensors.finger import TactileFinger
from uniforce_robots.sensors.orientation import TURNS
from uniforce_vtla.errors import ContractError, expected

QUARTERS = {
    "top-left": (-1, 1),
    "top-right": (1, 1),
    "bottom-left": (-1, -1),
    "bottom-right": (1, -1),
}  # x, y up
WAIT_MS = 1000.0
PRESSED_COUNTS = 400.0  # summed over a quarter's taxels; a light touch gives 300 on one
PRESSED_SHARE = 0.01  # of a quarter's pixels that changed
RELEASED = 0.5  # of those: the finger is off again
POLL_S = 0.004


@dataclass(frozen=True)
class RateReport:
    """What a rate check measured; ages at random moments, beside those of an idle loop's wake-ups."""

    rate_hz: float
    age_p50_ms: float
    age_p99_ms: float
    samples: int
    lost: int
    bad: int
    idle_p50_ms: float
    idle_p99_ms: float

    def __str__(self) -> str:
        return (
            f"rate {self.rate_hz:.1f} Hz over {self.samples} samples, lost {self.lost}, bad {self.bad}\n"
            f"age p50 {self.age_p50_ms:.2f} ms, p99 {self.age_p99_ms:.2f} ms "
            f"(an idle loop here wakes late by p50 {self.idle_p50_ms:.2f}, p99 {self.idle_p99_ms:.2f} ms)"
        )


def measure_rate(finger: TactileFinger, seconds: float) -> RateReport:
    """Return rate, ages and losses over ``seconds``; raises SensorError where the sensor dies meanwhile."""
    before, first = finger.counts, finger.latest(WAIT_MS).index
    rng, start_s = np.random.default_rng(0), time.monotonic()
    ages_ms, late_ms = [], []
    while time.monotonic() < start_s + seconds:
        pause_s = POLL_S * rng.uniform(0.5, 1.5)  # at no fixed phase to the samples
        asleep_s = time.perf_counter()
        time.sleep(pause_s)
        late_ms.append(1e3 * (time.perf_counter() - asleep_s - pause_s))
        ages_ms.append(finger.latest(WAIT_MS).age_ms)
    spent_s, after = time.monotonic() - start_s, finger.counts
    age_ms, idle_ms = (np.percentile(values, [50, 99]).tolist() for values in (ages_ms, late_ms))
    samples = finger.latest(WAIT_MS).index - first
    return RateReport(
        rate_hz=samples / spent_s,
        age_p50_ms=age_ms[0],
        age_p99_ms=age_ms[1],
        samples=samples,
        lost=after.lost - before.lost,
        bad=after.bad - before.bad,
        idle_p50_ms=idle_ms[0],
        idle_p99_ms=idle_ms[1],
    )


def check_rate(finger: TactileFinger, seconds: float) -> int:
    """Print what was measured; return 1 if anything was lost or unreadable."""
    report = measure_rate(finger, seconds)
    print(f"{finger.config.label}\n{report}")
    settings = finger.settings_read_back
    if settings:
        print("settings, read back: " + ", ".join(f"{name} {value:g}" for name, value in settings.items()))
    return int(report.lost + report.bad > 0)


def check_orientation(finger: TactileFinger, told: Sequence[str], seconds: float) -> int:
    """Have each quarter in ``told`` pressed, within ``seconds`` each; say which one moved. 0 if all agree.

    Raises:
        ContractError: a quarter with another name.
        SensorError: the sensor died.
    """
    unknown = sorted(set(told) - set(QUARTERS))
    if unknown:
        raise ContractError(expected("quarters", " | ".join(QUARTERS), unknown, "Name them as listed."))
    print("Look at the pad with the fingertip up, and press where told, alone and gently.")
    seen: dict[str, str] = {}
    for quarter in told:
        print(f"press the {quarter} of the pad …", flush=True)
        pressed = wait_for_press(finger, seconds)
        if pressed is None:
            print(f"  nothing felt within {seconds:g} s")
            return 1
        seen[quarter] = pressed
        print(
            f"  felt at the {pressed}{_strongest_taxel(finger)}: {'as told' if pressed == quarter else 'NOT as told'}"
        )
        _wait_for_release(finger, seconds)
    if all(quarter == moved for quarter, moved in seen.items()):
        print("orientation agrees")
        return 0
    print(advice(seen, finger.config.orientation.rotation_deg, finger.config.orientation.flip))
    return 1


def wait_for_press(finger: TactileFinger, seconds: float) -> str | None:
    """Return the quarter that moved most once one is pressed; None if none was within ``seconds``."""
    index, end_s = -1, time.monotonic() + seconds
    while time.monotonic() < end_s:
        touch = finger.next_touch(index, WAIT_MS)
        index, response = touch.index, quarter_response(finger, touch.raw)
        if response.max() >= 1:
            return list(QUARTERS)[int(response.argmax())]
    return None


def quarter_response(finger: TactileFinger, raw: np.ndarray) -> np.ndarray:
    """Return (4,) how much each of ``QUARTERS`` moved since the reference; 1 = counts as pressed."""
    if raw.ndim == 2:
        rise = np.maximum(raw.astype(np.int64) - finger.reference_raw, 0)[:, 2].reshape(4, 4)[::-1]
        scale = PRESSED_COUNTS
    else:
        rise = cv2.absdiff(finger.marker_image(raw), finger.reference_image()[..., 0]) / 255.0
        scale = PRESSED_SHARE * rise.size / 4
    half_y, half_x = rise.shape[0] // 2, rise.shape[1] // 2
    quarters = (
        rise[y, x] for y in (slice(half_y), slice(half_y, None)) for x in (slice(half_x), slice(half_x, None))
    )
    return np.array([float(quarter.sum()) for quarter in quarters]) / scale


def advice(seen: dict[str, str], rotation_deg: int, flip: bool) -> str:
    """Return what to set, given told → felt quarters seen under the present orientation."""
    fits = [
        (turn, mirror)
        for mirror in (False, True)
        for turn in TURNS
        if all(_moved(QUARTERS[felt], turn, mirror) == QUARTERS[told] for told, felt in seen.items())
    ]
    if rotation_deg or flip:
        return "orientation does not agree: run this check again with rotation_deg=0 flip=false to be told what to set"
    if len(fits) != 1:
        came = "no turn explains this" if not fits else "several turns explain this: press all four quarters"
        return f"orientation does not agree, and {came}"
    turn, mirror = fits[0]
    return f"orientation does not agree: set rotation_deg={turn} flip={str(mirror).lower()}"


def _moved(corner: tuple[int, int], turn: int, mirror: bool) -> tuple[int, int]:
    """Return where ``Orientation(turn, mirror)`` takes a corner: mirror first, then counter-clockwise."""
    x, y = (-corner[0] if mirror else corner[0]), corner[1]
    for _ in range(turn // 90):
        x, y = -y, x
    return x, y


def _strongest_taxel(finger: TactileFinger) -> str:
    raw = finger.latest(WAIT_MS).raw
    if raw.ndim != 2:
        return ""
    rise = (raw.astype(np.int64) - finger.reference_raw)[:, 2]
    return f", most at taxel {int(rise.argmax()) + 1} ({int(rise.max()):+d} counts)"


def _wait_for_release(finger: TactileFinger, seconds: float) -> None:
    index, end_s = -1, time.monotonic() + seconds
    while time.monotonic() < end_s:
        touch = finger.next_touch(index, WAIT_MS)
        index = touch.index
        if quarter_response(finger, touch.raw).max() < RELEASED:
            return
