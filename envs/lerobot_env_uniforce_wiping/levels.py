"""The locked difficulty levels: what a scene may draw, and the task's nominal layout."""

import hashlib
import json
from dataclasses import asdict, dataclass

from lerobot_env_uniforce_wiping.hidden import PullSettings, UnevenSettings
from uniforce_vtla.errors import ContractError, expected

CONTROL_HZ = 30.0
CAMERA_PX = 224  # side of both scene cameras' pictures
Range = tuple[float, float]


@dataclass(frozen=True)
class Layout:
    """Where things nominally are, in the robot base frame; known to every controller."""

    tray_m: tuple[float, float] = (0.48, -0.17)  # centre of the resting eraser
    grasp_height_m: float = 0.030  # pad centre above the eraser's felt
    start_height_m: float = 0.085  # tool height at the start
    carry_height_m: float = 0.075  # tool height above the table while carrying
    board_center_m: tuple[float, float] = (0.50, 0.04)  # centre of the writing
    board_height_m: float = 0.012  # nominal board surface above the table
    open_width_m: float = 0.050  # gripper width before the grasp
    eraser_width_m: float = 0.030  # nominal, along the closing axis x
    eraser_length_m: float = 0.060  # along the strokes, y
    eraser_height_m: float = 0.050  # felt included
    eraser_mass_kg: float = 0.055  # nominal


@dataclass(frozen=True)
class PadSettings:
    """How pads and the fingers behind them give way."""

    # under a flat face that covers the pad. Finite elements give flat gels 80 to 170 N/mm, of which
    # the time step carries 24 (40 chatters); a TacTip's dome has 4.2, real ones 3.3 to 4.7
    flat_N_mm: float = 24.0
    dome_N_mm: float = 4.2
    stiffest_N_mm: float = 30.0  # of any unit: what the time step carries
    # Shear, both pads alike, so that a load from outside is shared equally, F_L ≈ F_R: a TacTip
    # (4 N/mm by finite elements) on a finger that gives way by 12 N/mm. With stiffer springs one
    # pad carries a leaning eraser alone
    shear_N_mm: float = 3.0
    shear_damping_Ns_m: float = 12.0  # half critical


@dataclass(frozen=True)
class Level:
    """One difficulty: sweep geometry, time limit and the ranges a scene's variables are drawn from.

    The hidden ones have usual ranges; they reach a policy through contact and motion only.
    """

    name: str
    time_limit_s: float  # the episode is cut here
    rows: int  # strokes of the serpentine, odd rows come back
    row_pitch_m: float  # below the narrowest eraser, so rows overlap
    stroke_m: float  # travel of the tool along y in one row
    letter_height_m: float  # along x
    word_length_m: float  # along y
    words: tuple[str, ...]
    placement_m: float  # start pose and eraser placement spread, ±
    word_offset_m: float  # ± shift of the writing inside the swept area
    camera_shift_m: float  # ± camera position jitter
    camera_turn_rad: float  # ± camera rotation jitter
    letter_scale: Range  # size of the writing over its full box; a smaller word lies anywhere in it
    board_shift_m: float  # ± board in x and y, writing and all
    board_turn_rad: float  # ± board about the vertical
    eraser_turn_rad: float  # ± resting eraser about the vertical; closing pads square it up
    eraser_length_offset_m: Range
    light_gain: Range  # brightness of the cameras' pictures
    light_tint: float  # ± gain of each colour
    light_turn_rad: float  # ± direction the light comes from, about each axis
    # Archard constant: ink worn off per pressure and sliding distance. Clean after one sweep with
    # 6.5 N, after two or three with 4 N, seldom with less. Above 9 N the peaks are too much
    wear_per_kPa_m: float = 14.0
    wear_from_N: float = 2.0  # felt pressed with less glides over the ink
    adhesion_sigma: float = 0.15  # lognormal spread of ink adhesion over the board
    # hidden; stiffness and damping are drawn log-uniformly, over their nominal values
    stiffness_scale: Range = (0.5, 1.5)  # of the arm
    damping_scale: Range = (0.8, 1.2)  # of the arm
    stiction_Nm: Range = (0.05, 0.35)  # dry friction of each arm joint
    gripper_gain: Range = (0.5, 1.5)  # stiffness of the gripper's servo
    gripper_dead_band_m: Range = (0.0, 0.0003)  # smallest change of width the gripper answers
    board_offset_m: Range = (-0.006, 0.006)  # board height over nominal
    board_tilt_rad: Range = (-0.015, 0.015)  # about x and y
    eraser_width_offset_m: Range = (-0.002, 0.002)  # a pixel or two in the cameras
    eraser_mass_kg: Range = (0.040, 0.070)
    pad_friction: Range = (0.50, 0.85)
    board_friction: Range = (0.25, 0.40)
    layout: Layout = Layout()
    pads: PadSettings = PadSettings()
    pull: PullSettings | None = None  # hidden force on the hand
    uneven: UnevenSettings | None = None  # hidden heights of the board
    # of the sliding that a clean wipe presses within the limits' band
    in_band_share: float | None = None


SHORT_WORDS = ("hi", "ok", "go", "abc", "VLA", "2+2", "tea", "map")
_LONGER = ("robot", "touch", "wipe", "force", "hello", "chalk")
_LONGEST = ("Monday", "42 km", "x = 7", "to do", "Room 5", "latent")
WORDS = (*SHORT_WORDS, *_LONGER, *_LONGEST)

EASY = Level(
    name="easy",
    time_limit_s=12.0,
    rows=2,
    row_pitch_m=0.020,
    stroke_m=0.110,
    letter_height_m=0.030,
    word_length_m=0.072,
    words=SHORT_WORDS,
    placement_m=0.003,
    word_offset_m=0.002,
    camera_shift_m=0.004,
    camera_turn_rad=0.01,
    letter_scale=(0.8, 1.0),
    board_shift_m=0.002,
    board_turn_rad=0.015,
    eraser_turn_rad=0.03,
    eraser_length_offset_m=(-0.002, 0.002),
    light_gain=(0.85, 1.1),
    light_tint=0.03,
    light_turn_rad=0.2,
    wear_per_kPa_m=20.0,  # two rows, no time for a second sweep
)
# the benchmark: touch is needed, docs/experiments/scene.md
TOUCH = Level(
    name="touch",
    time_limit_s=30.0,
    rows=3,
    row_pitch_m=0.020,
    stroke_m=0.140,
    letter_height_m=0.048,
    word_length_m=0.100,
    words=WORDS,
    placement_m=0.004,
    word_offset_m=0.004,
    camera_shift_m=0.005,
    camera_turn_rad=0.015,
    letter_scale=(0.7, 1.0),
    board_shift_m=0.004,
    board_turn_rad=0.03,
    eraser_turn_rad=0.05,
    eraser_length_offset_m=(-0.004, 0.004),
    light_gain=(0.75, 1.15),
    light_tint=0.05,
    light_turn_rad=0.4,
    # a softer arm leaves regulation by touch too little gain against the pull
    stiffness_scale=(0.9, 1.8),
    gripper_gain=(0.45, 2.0),
    eraser_width_offset_m=(-0.004, 0.004),
    pull=PullSettings(),
    uneven=UnevenSettings(),
    in_band_share=0.8,
)
LEVELS: dict[str, Level] = {level.name: level for level in (EASY, TOUCH)}


def get_level(name: str) -> Level:
    """Return the level called ``name``; raise ContractError listing the known ones."""
    if name not in LEVELS:
        raise ContractError(
            expected("level", " | ".join(LEVELS), repr(name), "Check the spelling.")
        )
    return LEVELS[name]


def level_hash(level: Level) -> str:
    """Return 12 hex digits over every number of a level, so that scores name their level.

    Unset fields are left out, so that a new field leaves the other levels' hashes alone.
    """
    numbers = {name: value for name, value in asdict(level).items() if value is not None}
    text = json.dumps(numbers, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
