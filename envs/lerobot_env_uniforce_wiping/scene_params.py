"""One integer seed and a level → every number of a scene, so that any episode can be rebuilt."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_env_uniforce_wiping.levels import Level, Range, get_level

TASK_TEXTS = (  # the force is part of the task: it is scored
    "wipe the whiteboard with 6 N",
    "erase the word on the board, press with 6 N",
    "clean the whiteboard with the eraser at 6 N",
    "take the eraser and wipe off the writing with 6 N",
)


@dataclass(frozen=True)
class SceneParams:
    """A frozen scene. Hidden fields reach no observation; only contact and motion show them."""

    seed: int
    level: Level
    stiffness_scale: float
    damping_scale: float
    stiction_Nm: float
    gripper_gain: float
    gripper_dead_band_m: float
    board_height_m: float
    board_tilt_rad: tuple[float, float]  # about x, about y
    eraser_width_m: float
    eraser_mass_kg: float
    pad_friction: tuple[float, float]  # left, right
    board_friction: float
    eraser_offset_m: tuple[float, float]  # x, y from the tray's centre
    start_offset_m: tuple[float, float, float]
    word: str
    word_offset_m: tuple[float, float]
    camera_shift_m: tuple[tuple[float, ...], ...]  # per camera (x, y, z)
    camera_turn_rad: tuple[tuple[float, ...], ...]  # per camera rotation vector
    task: str
    letter_scale: float  # of the writing over its full box
    board_shift_m: tuple[float, float]  # x, y
    board_turn_rad: float  # about the vertical
    eraser_turn_rad: float  # about the vertical, at rest
    eraser_length_m: float
    light_gain: tuple[float, float, float]  # red, green, blue
    light_turn_rad: tuple[float, ...]  # rotation vector of the light's direction


def draw_scene(seed: int, level_name: str) -> SceneParams:
    """Draw a scene; equal arguments give an equal scene on any machine."""
    level = get_level(level_name)
    rng = np.random.default_rng([seed, 20260])
    drawn = _drawn(level, rng)
    return SceneParams(
        seed=seed, level=level, **drawn | _drawn_later(level, rng, drawn["word_offset_m"])
    )


def _drawn(level: Level, rng: np.random.Generator) -> dict[str, Any]:
    """Return field → value. The order of draws is part of a scene."""

    def uniform(span: Range) -> float:
        return float(rng.uniform(*span))

    def factor(span: Range) -> float:
        # twice as much is as likely as half as much
        return float(np.exp(rng.uniform(*np.log(span))))

    def spread(half: float, n: int) -> tuple[float, ...]:
        return tuple(float(v) for v in rng.uniform(-half, half, n))

    layout = level.layout
    friction = uniform(level.pad_friction)
    place = spread(level.placement_m, 2)
    return {
        "pad_friction": (friction, friction),
        "eraser_offset_m": place,
        "stiffness_scale": factor(level.stiffness_scale),
        "damping_scale": factor(level.damping_scale),
        "stiction_Nm": uniform(level.stiction_Nm),
        "gripper_gain": factor(level.gripper_gain),
        "gripper_dead_band_m": uniform(level.gripper_dead_band_m),
        "board_height_m": layout.board_height_m + uniform(level.board_offset_m),
        "board_tilt_rad": (uniform(level.board_tilt_rad), uniform(level.board_tilt_rad)),
        "eraser_width_m": layout.eraser_width_m + uniform(level.eraser_width_offset_m),
        "eraser_mass_kg": uniform(level.eraser_mass_kg),
        "board_friction": uniform(level.board_friction),
        "start_offset_m": spread(2 * level.placement_m, 3),
        "word": str(rng.choice(level.words)),
        "word_offset_m": spread(level.word_offset_m, 2),
        "camera_shift_m": tuple(spread(level.camera_shift_m, 3) for _ in range(2)),
        "camera_turn_rad": tuple(spread(level.camera_turn_rad, 3) for _ in range(2)),
        "task": str(rng.choice(TASK_TEXTS)),
    }


def _drawn_later(
    level: Level, rng: np.random.Generator, word_offset_m: tuple[float, ...]
) -> dict[str, Any]:
    """Return what came to scenes later, drawn last: what was drawn before stays as it was."""
    scale = float(rng.uniform(*level.letter_scale))
    room = (1 - scale) / 2 * np.array([level.letter_height_m, level.word_length_m])
    offset = np.array(word_offset_m) + room * rng.uniform(-1, 1, 2)
    shift = level.board_shift_m * rng.uniform(-1, 1, 2)
    gain = rng.uniform(*level.light_gain) * (1 + level.light_tint * rng.uniform(-1, 1, 3))
    return {
        "letter_scale": scale,
        "word_offset_m": tuple(offset.tolist()),
        "board_shift_m": tuple(shift.tolist()),
        "board_turn_rad": float(level.board_turn_rad * rng.uniform(-1, 1)),
        "eraser_turn_rad": float(level.eraser_turn_rad * rng.uniform(-1, 1)),
        "eraser_length_m": level.layout.eraser_length_m
        + float(rng.uniform(*level.eraser_length_offset_m)),
        "light_gain": tuple(gain.tolist()),
        "light_turn_rad": tuple((level.light_turn_rad * rng.uniform(-1, 1, 3)).tolist()),
    }
