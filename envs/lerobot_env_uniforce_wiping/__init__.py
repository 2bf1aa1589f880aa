"""The wiping scene: a MuJoCo environment in which touch is needed, and its scripted expert.

Importing it registers the environment type. ``WipeEnv`` and ``WipeExpert`` load MuJoCo.
"""

from typing import TYPE_CHECKING, Any

from lerobot_env_uniforce_wiping.lerobot_config import UniforceWipingConfig
from lerobot_env_uniforce_wiping.levels import LEVELS, level_hash
from lerobot_env_uniforce_wiping.scene_params import SceneParams, draw_scene

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv
    from lerobot_env_uniforce_wiping.expert import ExpertNoise, WipeExpert

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


def __getattr__(name: str) -> Any:
    if name == "WipeEnv":
        from lerobot_env_uniforce_wiping.env import WipeEnv

        return WipeEnv
    if name in ("ExpertNoise", "WipeExpert"):
        from lerobot_env_uniforce_wiping import expert

        return getattr(expert, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
