"""The scene for LeRobot's loops: a fault ends its own episode, not the whole run."""

import logging
from typing import Any

import gymnasium

from lerobot_env_uniforce_wiping.env import WipeEnv
from uniforce_vtla.errors import RobotError, SensorError, UniForceError

log = logging.getLogger(__name__)
Step = tuple[dict[str, Any], float, bool, bool, dict[str, Any]]


class AbortedEpisodes(gymnasium.Wrapper):
    """Truncate an episode whose sensor or hand fails; ``info["aborted"]`` says why.

    The episode counts as failed. Its last step repeats the last observation. Where the first
    observation failed, it shows the scene with ideal sensors. So the other environments of a vector
    go on.
    """

    def __init__(self, env: WipeEnv) -> None:
        super().__init__(env)
        self._scene = env
        self._end: Step | None = None
        self._seen: dict[str, Any] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Build a scene as ``WipeEnv.reset``."""
        self._end = None
        try:
            self._seen, info = self.env.reset(seed=seed, options=options)
        except SensorError as error:
            self._seen, info = self._as_drawn(seed)
            self._abort(error, info)
        return self._seen, info

    def step(self, action: Any) -> Step:
        """Take a step as ``WipeEnv.step``; an aborted episode ends with it, and nothing moves."""
        if self._end is not None:
            return self._end
        try:
            step = self.env.step(action)
        except (SensorError, RobotError) as error:
            return self._abort(error, self._scene._info())
        self._seen = step[0]
        return step

    def _abort(self, error: UniForceError, info: dict[str, Any]) -> Step:
        log.warning("episode aborted: %s", error)
        info |= {"is_success": False, "aborted": str(error)}
        self._end = (self._seen, 0.0, False, True, info)
        return self._end

    def _as_drawn(self, seed: int | None) -> tuple[dict[str, Any], dict[str, Any]]:
        scene = self._scene
        ideal = WipeEnv(
            scene.level.name,
            f"{scene.sensors['left']}:drawing",
            f"{scene.sensors['right']}:drawing",
            scene.drawn,
            scene.expose_wrench,
            gripper=scene.gripper,
            touch_in_state=scene.force_sensor is not None,
        )
        return ideal.reset(seed=seed)


def make_scene(**settings: Any) -> AbortedEpisodes:
    """Return a scene for LeRobot; settings as of ``WipeEnv``."""
    return AbortedEpisodes(WipeEnv(**settings))
