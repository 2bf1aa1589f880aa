"""One integer seed and a level → every number of a scene, so that any episode can be rebuilt."""

from __future__ import annotations

from dataclasses import dataclass

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


def draw_scene(seed: int, level_name: str) -> SceneParams:
    """Draw a scene; equal arguments give an equal scene on any machine."""
    level = get_level(level_name)
    rng = np.random.default_rng([seed, 20260])

    def uniform(span: Range) -> float:
        return float(rng.uniform(*span))

    def spread(half: float, n: int) -> tuple[float, ...]:
        return tuple(float(v) for v in rng.uniform(-half, half, n))

    friction = uniform(level.pad_friction)
    place = spread(level.placement_m, 2)
    return SceneParams(
        seed=seed,
        level=level,
        stiffness_scale=uniform(level.stiffness_scale),
        damping_scale=uniform(level.damping_scale),
        stiction_Nm=uniform(level.stiction_Nm),
        gripper_gain=uniform(level.gripper_gain),
        gripper_dead_band_m=uniform(level.gripper_dead_band_m),
        board_height_m=level.layout.board_height_m + uniform(level.board_offset_m),
        board_tilt_rad=(uniform(level.board_tilt_rad), uniform(level.board_tilt_rad)),
        eraser_width_m=level.layout.eraser_width_m + uniform(level.eraser_width_offset_m),
        eraser_mass_kg=uniform(level.eraser_mass_kg),
        pad_friction=(friction, friction),
        board_friction=uniform(level.board_friction),
        gel_scale=(uniform(level.gel_scale), uniform(level.gel_scale)),
        eraser_offset_m=(place[0], place[1]),
        start_offset_m=spread(2 * level.placement_m, 3),  # type: ignore[arg-type]
        word=str(rng.choice(level.words)),
        word_offset_m=spread(level.word_offset_m, 2),  # type: ignore[arg-type]
        camera_shift_m=tuple(spread(level.camera_shift_m, 3) for _ in range(2)),
        camera_turn_rad=tuple(spread(level.camera_turn_rad, 3) for _ in range(2)),
        task=str(rng.choice(TASK_TEXTS)),
    )
