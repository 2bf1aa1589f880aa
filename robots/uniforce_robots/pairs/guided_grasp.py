"""Guided grasps in numbers: the hand's motion, the load of both pads, and now and then a fault.

Axes: x = the fingers' closing axis is each pad's normal z; loads are canonical (fx, fy shear, fz
compression). The object is in equilibrium with what holds it from outside, but for the faults:

- ``jerked``: the hand is jerked along the closing axis; object and holder have mass, so one pad
  must push harder.
- ``free``: nothing holds the object from outside; pads askew to it shear it against each other.
- ``slipping``: one pad loses its grip and the other takes over its share of the load.
- ``one_finger``: one pad doesn't touch; the holder pushes back.
- ``pushed``: the person leans on the hand along the closing axis; the holder pushes back.

Magnitudes are plausible, not measured. Nothing here knows sensors or images.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from uniforce_robots.pairs.rig import CLOSING

FAULTS = ("jerked", "free", "slipping", "one_finger", "pushed")
GRIP_N = (2.0, 12.0)  # range of the firmest grip; while guided it varies below that
SHEAR_SHARE = 0.6  # largest load pulled through the object, as a share of what friction would hold
SLOW_m_s2 = 0.10  # root mean square acceleration of a hand that is led slowly
RESIDUAL = 0.01  # root mean square of the small differences no grasp is free of, share of the force
# of the robot's measurements
SPEED_NOISE_m_s = 0.002
ACCELERATION_NOISE_m_s2 = 0.10
GRIP_NOISE = 0.08  # relative standard deviation of the gripper's force estimate, one bias per grasp


@dataclass(frozen=True)
class GraspSettings:
    """How grasps are drawn.

    At first the hand rests while the fingers close to their firmest grip. Nothing else loads the
    pads then, so that each grasp shows how its two fingers compare.
    """

    rate_hz: float = 15.0  # frames per second
    frames: int = 45  # per grasp
    rest_s: float = 1.0
    # of the grasps in which something goes wrong, the faults taking equal parts
    fault_share: float = 0.5
    faults: tuple[str, ...] = FAULTS  # those that may be drawn

    @property
    def times_s(self) -> np.ndarray:
        """(T,) of the frames."""
        return np.arange(self.frames) / self.rate_hz


@dataclass(frozen=True)
class GuidedGrasp:
    """One grasp of T frames."""

    left_N: np.ndarray  # (T, 3) force that the left pad is to carry, canonical frame
    right_N: np.ndarray  # (T, 3) force that the right pad is to carry
    velocity_m_s: np.ndarray  # (T, 3) of the hand in its own frame, as measured
    acceleration_m_s2: np.ndarray  # (T, 3) of the hand in its own frame, as measured
    grip_N: np.ndarray  # (T,) the gripper's own estimate
    fault: str  # one of ``FAULTS``, or "none"


def draw_grasp(
    rng: np.random.Generator, settings: GraspSettings, mass_kg: float, friction: float = 1.0
) -> GuidedGrasp:
    """Return a random guided grasp of an object whose mass counts with what moves of its holder.

    The loads asked for stay below the pads' friction.
    """
    fault = str(rng.choice(settings.faults)) if rng.random() < settings.fault_share else "none"
    T = settings.frames
    dt = 1 / settings.rate_hz
    led = _after_rest(settings)
    grip = _grip(rng, settings)
    acceleration = SLOW_m_s2 * _wander(rng, T, 3, 4) * led[:, None]
    if fault == "jerked":
        acceleration[:, CLOSING] += _jerk(rng, settings)
    shear = _shear(rng, grip, friction) * led[:, None]
    difference = RESIDUAL * grip[:, None] * _wander(rng, T, 3, 8)
    difference[:, 2] += mass_kg * acceleration[:, CLOSING]
    left, right = _faulty(rng, settings, fault, friction, grip, shear, difference)
    velocity = np.cumsum(acceleration, axis=0) * dt
    # slow leading, its acceleration is in SLOW_m_s2
    velocity += 0.03 * _wander(rng, T, 3, 6) * led[:, None]
    velocity += SPEED_NOISE_m_s * rng.standard_normal((T, 3))
    acceleration += ACCELERATION_NOISE_m_s2 * rng.standard_normal((T, 3))
    grip_N = grip * (1 + GRIP_NOISE * rng.standard_normal()) + 0.1 * rng.standard_normal(T)
    return GuidedGrasp(left, right, velocity, acceleration, grip_N, fault)


def _faulty(
    rng: np.random.Generator, settings: GraspSettings, fault: str, friction: float,
    grip: np.ndarray, shear: np.ndarray, difference: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return what left and right carry with the fault in it."""
    window = _window(rng, settings)
    side = 1 if rng.random() < 0.5 else -1
    mean = np.column_stack([shear, grip])
    if fault == "free":
        mean[:, :2] *= 0.15  # only the object's weight is left to pull
        direction = rng.uniform(-np.pi, np.pi)
        askew = rng.uniform(0.12, 0.8) * friction * grip  # as soon as the pads close
        difference[:, :2] += askew[:, None] * [np.cos(direction), np.sin(direction)]
    elif fault == "pushed":
        difference[:, 2] += side * rng.uniform(0.15, 0.9) * grip * window
    elif fault == "slipping":
        mean[:, :2] = _at_least(rng, shear, 0.35 * friction * grip) * _after_rest(settings)[:, None]
        difference[:, :2] += side * rng.uniform(0.3, 0.9) * window[:, None] * mean[:, :2]
    left = mean + difference / 2
    right = mean - difference / 2
    if fault == "one_finger":
        lifted = left if side > 0 else right
        lifted *= (1 - window)[:, None] if rng.random() < 0.5 else 0.0
    return _carried(left, friction), _carried(right, friction)


def _carried(load: np.ndarray, friction: float) -> np.ndarray:
    """Return loads a pad can carry: no pull, and shear within friction."""
    load = load.copy()
    load[:, 2] = np.maximum(load[:, 2], 0)
    asked = np.maximum(np.linalg.norm(load[:, :2], axis=1), 1e-9)
    load[:, :2] *= np.minimum(1, 0.95 * friction * load[:, 2] / asked)[:, None]
    return load


def _at_least(rng: np.random.Generator, shear: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Return shear of at least ``least`` (T,): without a pull nothing slips."""
    size = np.linalg.norm(shear, axis=1)
    along = shear / np.maximum(size, 1e-9)[:, None]
    angle = rng.uniform(-np.pi, np.pi)
    along = np.where(size[:, None] > 1e-6, along, [np.cos(angle), np.sin(angle)])
    return along * np.maximum(size, least)[:, None]


def _grip(rng: np.random.Generator, settings: GraspSettings) -> np.ndarray:
    """Return (T,) normal force: closing gently to the firmest grip, then varying below it."""
    T = settings.frames
    peak = np.exp(rng.uniform(*np.log(GRIP_N)))
    closing = np.clip((np.arange(T) + 1) / (0.8 * settings.rest_s * settings.rate_hz), 0, 1)
    looser = 0.3 * (1 + np.tanh(_wander(rng, T, 1, 3)[:, 0])) * _after_rest(settings)
    return peak * closing * (1 - looser)


def _shear(rng: np.random.Generator, grip: np.ndarray, friction: float) -> np.ndarray:
    """Return (T, 2) load per finger that the holder pulls through the object, slowly turning."""
    share = SHEAR_SHARE * friction * rng.random()
    way = _wander(rng, len(grip), 2, 3)
    return share * grip[:, None] * way / np.maximum(1, np.abs(way).max())


def _wander(rng: np.random.Generator, frames: int, axes: int, knots: int) -> np.ndarray:
    """Return (T, axes) smooth random ways of unit variance through so many knots."""
    at = np.linspace(0, 1, knots + 2)
    return CubicSpline(at, rng.standard_normal((knots + 2, axes)))(np.linspace(0, 1, frames))


def _after_rest(settings: GraspSettings) -> np.ndarray:
    """Return (T,) 0 while the hand rests, then rising to 1 within 0.2 s."""
    return np.clip((settings.times_s - settings.rest_s) / 0.2, 0, 1)


def _window(rng: np.random.Generator, settings: GraspSettings) -> np.ndarray:
    """Return (T,) a stretch of the led part with soft ends, 1 inside."""
    start = rng.uniform(settings.rest_s + 0.1, 0.6 * settings.frames / settings.rate_hz)
    stop = start + rng.uniform(0.3, 0.9)
    return np.clip(
        np.minimum((settings.times_s - start) / 0.1, (stop - settings.times_s) / 0.1), 0, 1
    )


def _jerk(rng: np.random.Generator, settings: GraspSettings) -> np.ndarray:
    """Return (T,) m/s² of two to four jerks there and back."""
    time = settings.times_s
    jerk = np.zeros_like(time)
    for _ in range(rng.integers(2, 5)):
        at = rng.uniform(settings.rest_s + 0.2, time[-1])
        width = rng.uniform(0.08, 0.2)
        shape = (time - at) / width
        jerk += rng.choice([-1, 1]) * rng.uniform(3, 12) * shape * np.exp(0.5 - shape**2 / 2)
    return jerk
