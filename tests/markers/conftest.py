"""Synthetic raw frames with known markers, after how real recordings look: see the docstrings."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

REAL = Path(__file__).parents[2].parent / "shared" / "real"


@dataclass(frozen=True)
class Scene:
    """A raw frame and the true marker centres in canonical px."""

    frame: np.ndarray
    centres_px: np.ndarray


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


def _to_canonical_px(points, size):
    width, height = size
    scale = min(640 / width, 480 / height)
    offset = np.array([(640 - round(width * scale)) // 2, (480 - round(height * scale)) // 2])
    return (points + 0.5) * scale - 0.5 + offset


def _dome(
    rings=10, size=(640, 480), pressed=False, rim="ring", reflections=0, brightness=170.0, seed=0
):
    """Bright pins on a black dome behind a fisheye, dimmer and smaller outwards; a bright rim; LED reflections."""
    rng, (width, height) = np.random.default_rng(seed), size
    s, centre = height / 480, np.array([width / 2 + 8, height / 2 - 5])
    y, x = np.mgrid[:height, :width]
    distance, angle = (
        np.hypot(x - centre[0], y - centre[1]) / s,
        np.arctan2(y - centre[1], x - centre[0]),
    )
    points, radius = _fisheye_hexagon(rings)
    points = points * 200 * s
    if pressed:  # pins move outwards and thin out where a dome is pressed
        away = points - np.array([40, 20]) * s
        points = points + 0.3 * away * np.exp(-((np.hypot(*away.T) / (70 * s)) ** 2))[:, None]
    points = points + centre
    pins = np.zeros((height, width), np.float32)
    for (px, py), r in zip(points, radius, strict=True):
        pin_px = max(1.5, (4.6 - 1.6 * r) * s * (10 / rings) ** 0.6)
        at = round(px * 16), round(py * 16)
        cv2.circle(
            pins, at, round(pin_px * 16), brightness * (1 - 0.45 * r), cv2.FILLED, cv2.LINE_AA, 4
        )
    pins = cv2.GaussianBlur(pins, (0, 0), s)
    frame = (14 + 18 * np.exp(-((distance / 180) ** 2)))[..., None] + pins[..., None] * (
        0.75,
        0.85,
        1.0,
    )
    if rim == "ring":
        frame += (np.exp(-(((distance - 228) / 5) ** 2)) * 200 * (0.55 + 0.45 * np.sin(3 * angle)))[
            ..., None
        ]
    elif rim == "arcs":
        frame += (np.exp(-(((distance - 230) / 5) ** 2)) * 220 * (np.sin(14 * angle) > 0))[
            ..., None
        ]
    elif rim == "bright outside":
        frame[distance > 226] = (190, 195, 200)
    for i in range(reflections):
        a = 2 * np.pi * i / reflections
        at = centre + 150 * s * np.array([np.cos(a), np.sin(a)])
        axes = round(11 * s), round(6 * s)
        cv2.ellipse(
            frame,
            (int(at[0]), int(at[1])),
            axes,
            np.degrees(a),
            0,
            360,
            (255, 255, 255),
            cv2.FILLED,
        )
    frame += rng.normal(0, 4, frame.shape)
    return Scene(np.clip(frame, 0, 255).astype(np.uint8), _to_canonical_px(points, size))


def _fisheye_hexagon(rings):
    axial = [
        (q, r)
        for q in range(-rings, rings + 1)
        for r in range(-rings, rings + 1)
        if abs(q + r) <= rings
    ]
    points = np.array([(q + r / 2, r * np.sqrt(3) / 2) for q, r in axial]) / rings
    radius = np.hypot(*points.T)
    squeeze = np.sin(radius * 1.15) / np.sin(1.15) / np.maximum(radius, 1e-9)
    return points * squeeze[:, None], radius


def _gel(
    grid=(8, 10),
    size=(640, 480),
    shape="square",
    dark=True,
    streak=False,
    contrast=0.75,
    noise=4.0,
    seed=0,
):
    """A flat gel under three coloured lights, vignetted, with markers a little off their grid."""
    rng, (width, height) = np.random.default_rng(seed), size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x, y = x / width, y / height
    light = np.stack([110 + 110 * x, 130 + 80 * (1 - y), 120 + 100 * (1 - x) * y], axis=-1)
    frame = light * (1 - 1.1 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))[..., None]
    rows, columns = grid
    gx, gy = (np.linspace(0.075, 0.925, n) * full for n, full in ((columns, width), (rows, height)))
    pitch = min(gx[1] - gx[0], gy[1] - gy[0])
    points = np.stack(np.meshgrid(gx, gy), axis=-1).reshape(-1, 2)
    points = np.rint(points + rng.normal(0, 0.03 * pitch, points.shape))
    ink = cv2.GaussianBlur(_ink(points, 0.18 * pitch, shape, size), (0, 0), 1.2)[..., None]
    frame = frame * (1 - contrast * ink) if dark else frame + ink * (90, 110, -40)
    if streak:
        ends = (int(width * 0.3), int(height * 0.2)), (int(width * 0.55), int(height * 0.7))
        cv2.line(frame, *ends, (255, 255, 255), max(2, 5 * width // 640), cv2.LINE_AA)
    frame = frame + rng.normal(0, noise, frame.shape)
    return Scene(np.clip(frame, 0, 255).astype(np.uint8), _to_canonical_px(points, size))


def _ink(points, half, shape, size):
    ink = np.zeros(size[::-1], np.float32)
    wide, tall = {"square": (half, half), "dash": (1.3 * half, 0.45 * half), "dot": (half, half)}[
        shape
    ]
    for x, y in points:
        if shape == "dot":
            cv2.circle(ink, (int(x), int(y)), round(half), 1.0, cv2.FILLED)
        else:
            corners = (round(x - wide), round(y - tall)), (round(x + wide), round(y + tall))
            cv2.rectangle(ink, *corners, 1.0, cv2.FILLED)
    return ink
