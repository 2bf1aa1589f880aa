"""One integer seed and a level → every number of a scene, so that any episode can be rebuilt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_env_uniforce_wiping.levels import Level, Range, get_level

TASK_TEXTS = (
    "wipe the whiteboard",
    "erase the word on the board",
    "clean the whiteboard with the eraser",
    "take the eraser and wipe off the writing",
)


@dataclass(frozen=True)
class SceneParams:
    """A frozen scene. Hidden fields never reach an observation, only contact and motion show them."""

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
    gel_scale: tuple[float, float]  # left, right
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
    eraser_turn_rad: float  # likewise, at rest
    eraser_length_m: float
    light_gain: tuple[float, float, float]  # red, green, blue
    light_turn_rad: tuple[float, ...]  # rotation vector of the light's direction


def draw_scene(seed: int, level_name: str) -> SceneParams:
    """Draw a scene; equal arguments give an equal scene on any machine."""
    level = get_level(level_name)
    rng = np.random.default_rng([seed, 20260])

    def uniform(span: Range) -> float:
        return float(rng.uniform(*span))

    def factor(span: Range) -> float:
        return float(np.exp(rng.uniform(*np.log(span))))  # twice as much is as likely as half as much

    def spread(half: float, n: int) -> tuple[float, ...]:
        return tuple(float(v) for v in rng.uniform(-half, half, n))

    friction = uniform(level.pad_friction)
    place = spread(level.placement_m, 2)
    scene = SceneParams(
        seed=seed,
        level=level,
        stiffness_scale=factor(level.stiffness_scale),
        damping_scale=factor(level.damping_scale),
        stiction_Nm=uniform(level.stiction_Nm),
        gripper_gain=factor(level.gripper_gain),
        gripper_dead_band_m=uniform(level.gripper_dead_band_m),
        board_height_m=level.layout.board_height_m + uniform(level.board_offset_m),
        board_tilt_rad=(uniform(level.board_tilt_rad), uniform(level.board_tilt_rad)),
        eraser_width_m=level.layout.eraser_width_m + uniform(level.eraser_width_offset_m),
        eraser_mass_kg=uniform(level.eraser_mass_kg),
        pad_friction=(friction, friction),
        board_friction=uniform(level.board_friction),
        gel_scale=(factor(level.gel_scale), factor(level.gel_scale)),
        eraser_offset_m=(place[0], place[1]),
        start_offset_m=spread(2 * level.placement_m, 3),  # type: ignore[arg-type]
        word=str(rng.choice(level.words)),
        word_offset_m=spread(level.word_offset_m, 2),  # type: ignore[arg-type]
        camera_shift_m=tuple(spread(level.camera_shift_m, 3) for _ in range(2)),
        camera_turn_rad=tuple(spread(level.camera_turn_rad, 3) for _ in range(2)),
        task=str(rng.choice(TASK_TEXTS)),
        letter_scale=1.0,
        board_shift_m=(0.0, 0.0),
        board_turn_rad=0.0,
        eraser_turn_rad=0.0,
        eraser_length_m=level.layout.eraser_length_m,
        light_gain=(1.0, 1.0, 1.0),
        light_turn_rad=(0.0, 0.0, 0.0),
    )
    return _varied(scene, rng)


def _varied(scene: SceneParams, rng: np.random.Generator) -> SceneParams:
    """Return the scene with its later variety, drawn last: what was drawn before stays as it was."""
    level = scene.level
    scale = float(rng.uniform(*level.letter_scale))
    room = (1 - scale) / 2 * np.array([level.letter_height_m, level.word_length_m])
    offset = np.array(scene.word_offset_m) + room * rng.uniform(-1, 1, 2)
    shift = level.board_shift_m * rng.uniform(-1, 1, 2)
    gain = rng.uniform(*level.light_gain) * (1 + level.light_tint * rng.uniform(-1, 1, 3))
    return replace(
        scene,
        letter_scale=scale,
        word_offset_m=(float(offset[0]), float(offset[1])),
        board_shift_m=(float(shift[0]), float(shift[1])),
        board_turn_rad=float(level.board_turn_rad * rng.uniform(-1, 1)),
        eraser_turn_rad=float(level.eraser_turn_rad * rng.uniform(-1, 1)),
        eraser_length_m=scene.eraser_length_m + float(rng.uniform(*level.eraser_length_offset_m)),
        light_gain=tuple(float(g) for g in gain),  # type: ignore[arg-type]
        light_turn_rad=tuple(float(v) for v in level.light_turn_rad * rng.uniform(-1, 1, 3)),
    )
