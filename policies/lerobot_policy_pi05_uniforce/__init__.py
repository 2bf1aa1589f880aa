"""π0.5 with force tokens.  Importing this package registers everything the distribution gives to LeRobot."""

import lerobot_camera_uniforce  # noqa: F401  registers the tactile fingers as camera types
import lerobot_env_uniforce_wiping  # noqa: F401  registers the environment type
import lerobot_robot_uniforce_franka  # noqa: F401  registers the robot type; no client is loaded
import lerobot_teleoperator_uniforce  # noqa: F401  registers the teleoperator types; no device is touched
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import make_pi05_uniforce_pre_post_processors

__all__ = ["PI05UniforceConfig", "PI05UniforcePolicy", "make_pi05_uniforce_pre_post_processors"]
