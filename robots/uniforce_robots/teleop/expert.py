"""The scripted expert as a teleoperator: it knows the simulated scene's true wrench, so it works in simulation only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_vtla.errors import TeleoperatorError, expected

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping import WipeEnv


@TeleoperatorConfig.register_subclass("uniforce_expert")
@dataclass(kw_only=True)
class UniforceExpertConfig(TeleoperatorConfig):
    """The scripted expert of the simulated scene; of no use to a real robot."""

    fingers: Literal["both", "left", "right", "none"] = "both"  # which pads it reads


class UniforceExpert(UniforceTeleoperator):
    """``attach`` a scene, then as any other; each episode starts after the scene's reset."""

    config_class = UniforceExpertConfig
    name = "uniforce_expert"
    is_connected = False
    env: WipeEnv

    def attach(self, env: WipeEnv) -> None:
        """Take the scene whose wrench it reads."""
        self.env = env

    def _open(self) -> None:
        from lerobot_env_uniforce_wiping import WipeExpert  # mujoco: only where there is a scene

        if not hasattr(self, "env"):
            do = "Use it with robot=sim, or attach(env) a scene; on a robot take another teleoperator."
            raise TeleoperatorError(expected(self.name, "a simulated scene", "none", do), "simulation_only")
        self._expert = WipeExpert(self.config.fingers)
        self.is_connected = True

    def _close(self) -> None:
        self.is_connected = False

    def _begin(self, measured: np.ndarray) -> None:
        self._expert.reset(self.env)

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self._expert.act(self.env).astype(np.float64)
