"""The scripted expert as a teleoperator: it knows the simulated scene's true wrench, so it works in simulation only."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceExpertConfig
from uniforce_vtla.errors import TeleoperatorError, expected

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping import WipeEnv


class UniforceExpert(UniforceTeleoperator):
    """``attach`` a scene, then as any other; each episode starts after the scene's reset."""

    config_class = UniforceExpertConfig
    name = "uniforce_expert"

    def __init__(self, config: UniforceExpertConfig) -> None:
        super().__init__(config)
        self._env: WipeEnv | None = None
        self._is_open = False

    def attach(self, env: WipeEnv) -> None:
        """Take the scene whose wrench it reads."""
        self._env = env

    @property
    def is_connected(self) -> bool:
        """Whether it has a scene and was connected."""
        return self._is_open and self._env is not None

    def _open(self) -> None:
        from lerobot_env_uniforce_wiping import WipeExpert  # mujoco: only where there is a scene

        if self._env is None:
            do = "Use it with robot=sim, or attach(env) a scene; on a robot take another teleoperator."
            raise TeleoperatorError(expected(self.name, "a simulated scene", "none", do), "simulation_only")
        self._expert = WipeExpert(self.config.fingers)
        self._is_open = True

    def _close(self) -> None:
        self._is_open = False

    def _begin(self, measured: np.ndarray) -> None:
        self._expert.reset(self._scene())

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self._expert.act(self._scene()).astype(np.float64)

    def _scene(self) -> WipeEnv:
        assert self._env is not None  # is_connected has looked
        return self._env
