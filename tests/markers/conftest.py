"""Synthetic raw frames with known markers, after how real recordings look: see the docstrings."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from uniforce_vtla.sensors.layouts import hexagonal

REAL = Path(__file__).parents[2].parent / "shared" / "real"


@pytest.fixture(scope="session")
def real_folder():
    if not REAL.is_dir():
        pytest.skip(f"no real recordings at {REAL}")
    return REAL


@pytest.fixture(scope="session")
def dome():
    return _dome


@pytest.fixture(scope="session")
def gel():
    return _gel


def _scene(frame, points, size):
    """Return a raw uint8 frame and the true marker centres in canonical px."""
    scale = min(640 / size[0], 480 / size[1])
    margins = (np.array([640, 480]) - np.rint(np.array(size) * scale)) // 2
    frame = np.clip(frame, 0, 255).astype(np.uint8)
    return SimpleNamespace(frame=frame, centres_px=(points + 0.5) * scale - 0.5 + margins)


def _dome(
    rings=10, size=(640, 480), pressed=False, rim="ring", reflections=0, brightness=170.0, seed=0
):
    """Bright pins on a black dome behind a fisheye, dimmer and smaller outwards; a bright rim; LED
    reflections."""
    rng = np.random.default_rng(seed)
    width, height = size
    s = height / 480
    centre = np.array([width / 2 + 8, height / 2 - 5])
    y, x = np.mgrid[:height, :width]
    distance = np.hypot(x - centre[0], y - centre[1]) / s
    angle = np.arctan2(y - centre[1], x - centre[0])
    points = hexagonal(rings, 1 / rings).astype(float)
    radius = np.hypot(*points.T)
    fisheye = np.sin(radius * 1.15) / np.sin(1.15) / np.maximum(radius, 1e-9)
    points *= fisheye[:, None] * 200 * s
    if pressed:  # pins move outwards and thin out where a dome is pressed
        away = points - np.array([40, 20]) * s
        points += 0.3 * away * np.exp(-((np.hypot(*away.T) / (70 * s)) ** 2))[:, None]
    points += centre
    pins = np.zeros((height, width), np.float32)
    pin_px = np.maximum(1.5, (4.6 - 1.6 * radius) * s * (10 / rings) ** 0.6)
    for at, pin, grey in zip(points, pin_px, brightness * (1 - 0.45 * radius), strict=True):
        _disc(pins, at, pin, grey)
    pins = cv2.GaussianBlur(pins, (0, 0), s)[..., None]
    frame = (14 + 18 * np.exp(-((distance / 180) ** 2)))[..., None] + pins * (0.75, 0.85, 1.0)
    lit = {"ring": 200 * (0.55 + 0.45 * np.sin(3 * angle)), "arcs": 220 * (np.sin(14 * angle) > 0)}
    if rim in lit:
        frame += (np.exp(-(((distance - 228) / 5) ** 2)) * lit[rim])[..., None]
    if rim == "bright outside":
        frame[distance > 226] = (190, 195, 200)
    for turn in np.arange(reflections) * 360 / max(reflections, 1):
        way = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
        ellipse = centre + 150 * s * way, (22 * s, 12 * s), turn
        cv2.ellipse(frame, ellipse, (255, 255, 255), cv2.FILLED)
    frame += rng.normal(0, 4, frame.shape)
    return _scene(frame, points, size)


def _disc(image, at, radius, grey):
    """Fill a disc in place, to a sixteenth of a pixel."""
    x, y, radius = np.rint(np.array([*at, radius]) * 16).astype(int).tolist()
    cv2.circle(image, (x, y), radius, grey, cv2.FILLED, cv2.LINE_AA, 4)


def _gel(
    grid=(8, 10), size=(640, 480), shape="square", dark=True, streak=False, contrast=0.75, noise=4.0
):
    """A flat gel under three coloured lights, vignetted, with markers a little off their grid."""
    rng = np.random.default_rng(0)
    width, height = size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x /= width
    y /= height
    light = np.stack([110 + 110 * x, 130 + 80 * (1 - y), 120 + 100 * (1 - x) * y], axis=-1)
    frame = light * (1 - 1.1 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))[..., None]
    rows, columns = grid
    gx = np.linspace(0.075, 0.925, columns) * width
    gy = np.linspace(0.075, 0.925, rows) * height
    pitch = min(gx[1] - gx[0], gy[1] - gy[0])
    points = np.stack(np.meshgrid(gx, gy), axis=-1).reshape(-1, 2)
    points = np.rint(points + rng.normal(0, 0.03 * pitch, points.shape))
    ink = cv2.GaussianBlur(_ink(points, 0.18 * pitch, shape, size), (0, 0), 1.2)[..., None]
    frame = frame * (1 - contrast * ink) if dark else frame + ink * (90, 110, -40)
    if streak:
        ends = (int(width * 0.3), int(height * 0.2)), (int(width * 0.55), int(height * 0.7))
        cv2.line(frame, *ends, (255, 255, 255), max(2, 5 * width // 640), cv2.LINE_AA)
    frame = frame + rng.normal(0, noise, frame.shape)
    return _scene(frame, points, size)


def _ink(points, half, shape, size):
    ink = np.zeros(size[::-1], np.float32)
    reach = np.array([1.3, 0.45]) if shape == "dash" else np.ones(2)
    for at in points:
        if shape == "dot":
            cv2.circle(ink, at.astype(int).tolist(), round(half), 1.0, cv2.FILLED)
        else:
            low, high = np.rint([at - half * reach, at + half * reach]).astype(int).tolist()
            cv2.rectangle(ink, low, high, 1.0, cv2.FILLED)
    return ink
