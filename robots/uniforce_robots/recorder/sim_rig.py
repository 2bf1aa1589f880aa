"""The simulated wiping scene as a rig."""

from typing import Any

import numpy as np

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.cameras import CAMERA_PX
from uniforce_robots.recorder.rig import FingerTouch, Observation, Picture, Rig, RigFacts
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.evaluation.episode import EpisodeResult
from uniforce_vtla.keys import CAMERAS, tactile_name, truth_wrench_key


class SimRig(Rig):
    """A scene at its own clock, or at the wall's if ``paced``; sensors are never late."""

    def __init__(self, env: WipeEnv, paced: bool = True) -> None:
        self.env = env
        cameras = dict.fromkeys(CAMERAS, (CAMERA_PX, CAMERA_PX, 3))
        sensors = {finger: env.sensors[finger] for finger in FINGERS}
        fps = int(env.metadata["render_fps"])
        self.facts = RigFacts("sim", fps, sensors, cameras, paced=paced, simulated=True)
        self._step = 0
        self._seen: dict[str, Any] = {}
        self._references: dict[Finger, np.ndarray] = {}

    @property
    def prompt(self) -> str | None:  # type: ignore[override]
        """The scene's own words."""
        return self.env.task

    def now_s(self) -> float:
        """Return the seconds since the scene was built."""
        return self._step / self.facts.fps

    def connect(self) -> None:
        """Build a first scene."""
        self.begin_episode(0)

    def close(self) -> None:
        """Free the renderer."""
        self.env.close()

    def axes(self) -> np.ndarray:
        """Return (5,) where the tool is."""
        return self.env.state.astype(np.float64)

    def begin_episode(self, seed: int) -> None:
        """Build the scene of ``seed``; its pads are in free air."""
        self._seen, _ = self.env.reset(seed=seed)
        self._step = 0
        self.is_done = False
        pixels = self._seen["pixels"]
        self._references = {
            f: pixels[tactile_name(f, reference=True)][..., 0].copy() for f in FINGERS
        }

    def observe(self) -> Observation:
        """Return the scene as it is after the last step."""
        pixels = self._seen["pixels"]
        now_s = self.now_s()
        step = self._step
        images = {f: pixels[tactile_name(f)][..., 0] for f in FINGERS}
        return Observation(
            time_s=now_s,
            axes=self._seen["agent_pos"],
            cameras={name: Picture(pixels[name], step, now_s) for name in CAMERAS},
            fingers={f: FingerTouch(images[f], step, now_s, self._references[f]) for f in FINGERS},
            measured={
                truth_wrench_key(f): w.astype(np.float32) for f, w in self.env.true_wrench().items()
            },
            force_N=np.array([0.0, 0.0, self.env.sim.press_N]),
        )

    def act(self, action: np.ndarray) -> np.ndarray:
        """Take one step; nothing guards a scene but its own refusal of what is not finite."""
        self._seen, _, terminated, truncated, _ = self.env.step(action)
        self._step += 1
        self.is_done = terminated or truncated
        return action

    def verdict(self) -> EpisodeResult:
        """Score the episode from the scene's truth."""
        return self.env.result()

    def summary(self) -> dict[str, Any]:
        """Name the level."""
        return {"level": self.env.level.name}
