"""The wiping scene: a MuJoCo environment in which touch is needed, its scripted expert and blind scripts."""

from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.expert import ExpertNoise, WipeExpert
from lerobot_env_uniforce_wiping.lerobot_config import UniforceWipingConfig
from lerobot_env_uniforce_wiping.levels import LEVELS, level_hash
from lerobot_env_uniforce_wiping.scene_params import SceneParams, draw_scene

__all__ = [
    "LEVELS",
    "ExpertNoise",
    "SceneParams",
    "UniforceWipingConfig",
    "WipeEnv",
    "WipeExpert",
    "draw_scene",
    "level_hash",
]
