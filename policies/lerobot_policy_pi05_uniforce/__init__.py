"""π0.5 with force tokens. Importing this registers everything the distribution gives to LeRobot."""

import lerobot_env_uniforce_wiping  # noqa: F401  registers the environment type
import uniforce_robots.franka
import uniforce_robots.sensors
import uniforce_robots.teleop  # noqa: F401  registers the teleoperator types; no device is touched
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import (
    make_pi05_uniforce_pre_post_processors,
)

__all__ = ["PI05UniforceConfig", "PI05UniforcePolicy", "make_pi05_uniforce_pre_post_processors"]
