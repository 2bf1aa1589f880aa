"""The scene as a LeRobot environment type: ``--env.type=uniforce_wiping``."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from lerobot_env_uniforce_wiping.levels import CAMERA_PX, CONTROL_HZ, get_level
from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE
from uniforce_vtla.keys import ACTION, AXES, CAMERAS, STATE, TACTILE_KEYS, camera_key

# of ``WipeEnv`` that LeRobot's commands may set
SETTINGS = (
    "level",
    "left_sensor",
    "right_sensor",
    "gripper",
    "expose_wrench",
    "touch_in_state",
    "right_calibration",
)
GYM_ID = "uniforce_wiping/WipeWhiteboard-v0"
if GYM_ID not in gymnasium.registry:
    gymnasium.register(GYM_ID, entry_point="lerobot_env_uniforce_wiping.aborted:make_scene")


def _features() -> dict[str, PolicyFeature]:
    visual = FeatureType.VISUAL
    pad = (*MARKER_IMAGE_SHAPE, 3)
    cameras = {camera_key(c): PolicyFeature(visual, (CAMERA_PX, CAMERA_PX, 3)) for c in CAMERAS}
    tactile = {key: PolicyFeature(visual, pad) for key in TACTILE_KEYS}
    axes = (len(AXES),)
    own = {
        ACTION: PolicyFeature(FeatureType.ACTION, axes),
        STATE: PolicyFeature(FeatureType.STATE, axes),
    }
    return own | cameras | tactile


@EnvConfig.register_subclass("uniforce_wiping")
@dataclass
class UniforceWipingConfig(EnvConfig):
    """Settings of the scene for LeRobot's commands; ``--env.left_sensor=uskin`` swaps a sensor."""

    task: str | None = "WipeWhiteboard-v0"
    fps: int = int(CONTROL_HZ)
    level: str = "easy"
    left_sensor: str = "gelsight"
    right_sensor: str = "tactip"
    gripper: str = "hand"  # hand, under the rules of the robot's | servo, follows each width
    expose_wrench: bool = False  # ceiling control only
    # the right finger's newtons behind the state, no marker images: for any LeRobot policy
    touch_in_state: bool = False
    right_calibration: str = ""  # with touch_in_state: folder of `uniforce calibrate`
    episode_length: int | None = None  # steps; None = the level's own
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.expose_wrench:
            wrench = PolicyFeature(FeatureType.STATE, (4,))
            self.features = self.features | {f"observation.wrench_{f}": wrench for f in FINGERS}
        if self.touch_in_state:
            scene = {k: feature for k, feature in self.features.items() if k not in TACTILE_KEYS}
            self.features = scene | {STATE: PolicyFeature(FeatureType.STATE, (len(AXES) + 3,))}
        self.features_map = self.features_map or {key: key for key in self.features}
        if self.episode_length is None:
            self.episode_length = round(get_level(self.level).time_limit_s * CONTROL_HZ)

    @property
    def package_name(self) -> str:
        """The package that registers the gymnasium id."""
        return "lerobot_env_uniforce_wiping"

    @property
    def gym_id(self) -> str:
        """Registered gymnasium id."""
        return GYM_ID

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of ``WipeEnv``."""
        settings = {"max_steps": self.episode_length}
        for name in SETTINGS:
            settings[name] = getattr(self, name)
        return settings
