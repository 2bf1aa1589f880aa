"""The simulated wiping scene as a rig."""

from __future__ import annotations

from typing import Any

import numpy as np

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.cameras import CAMERA_PX
from uniforce_recording.observation import FingerTouch, Observation, Picture
from uniforce_recording.rig import RigFacts, Verdict
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.keys import CAMERAS, tactile_name, truth_wrench_key


class SimRig:
    """A scene at its own clock; sensors are captured at the observation itself.

    Args:
        env: the scene.
        paced: keep to the wall clock, so that a person can steer.
    """

    def __init__(self, env: WipeEnv, paced: bool = True) -> None:
        self.env = env
        self._fps = int(env.metadata["render_fps"])
        self._paced = paced
        self._step = 0
        self._seen: dict[str, Any] = {}
        self._references: dict[Finger, np.ndarray] = {}
        self._done = False

    @property
    def facts(self) -> RigFacts:
        """See ``Rig``."""
        return RigFacts(
            name="sim",
            fps=self._fps,
            sensors={finger: self.env.sensors[finger] for finger in FINGERS},
            cameras=dict.fromkeys(CAMERAS, (CAMERA_PX, CAMERA_PX, 3)),
            truth=True,
            paced=self._paced,
        )

    @property
    def is_done(self) -> bool:
        """Whether the board is wiped and the tool lifted, or the time is up."""
        return self._done

    @property
    def can_drive_between(self) -> bool:
        """Never: a new scene is built anyway."""
        return False

    @property
    def prompt(self) -> str | None:
        """The scene's own words."""
        return self.env.task

    def now_s(self) -> float:
        """Seconds since the scene was built."""
        return self._step / self._fps

    def connect(self) -> None:
        """Build a first scene."""
        self.begin_episode(0)

    def close(self) -> None:
        """Free the renderer."""
        self.env.close()

    def axes(self) -> np.ndarray:
        """(5,) where the tool is."""
        return self.env.state.astype(np.float64)

    def begin_episode(self, seed: int) -> None:
        """Build the scene of ``seed``; its pads are in free air."""
        self._seen, _ = self.env.reset(seed=seed)
        self._step, self._done = 0, False
        pixels = self._seen["pixels"]
        self._references = {f: pixels[tactile_name(f, reference=True)][..., 0].copy() for f in FINGERS}

    def observe(self) -> Observation:
        """Return the scene as it is after the last step."""
        pixels, now_s = self._seen["pixels"], self.now_s()
        wrenches = self.env.true_wrench()
        return Observation(
            time_s=now_s,
            axes=self._seen["agent_pos"],
            cameras={name: Picture(pixels[name], self._step, now_s) for name in CAMERAS},
            fingers={
                f: FingerTouch(pixels[tactile_name(f)][..., 0], self._references[f], self._step, now_s)
                for f in FINGERS
            },
            measured={truth_wrench_key(f): wrench.astype(np.float32) for f, wrench in wrenches.items()},
            force_N=np.array([0.0, 0.0, self.env.sim.press_N]),
        )

    def act(self, action: np.ndarray) -> np.ndarray:
        """Take one step; nothing guards a scene but its own refusal of what is not finite."""
        self._seen, _, terminated, truncated, _ = self.env.step(action)
        self._step += 1
        self._done = terminated or truncated
        return action

    def hold(self) -> None:
        """Do nothing: a scene that isn't stepped stands still."""

    def recover(self) -> None:
        """Do nothing: a scene has no faults."""

    def verdict(self) -> Verdict | None:
        """Score the episode from the scene's truth."""
        result = self.env.result()
        return Verdict(result.outcome, result.clean)

    def summary(self) -> dict[str, Any]:
        """Name the level."""
        return {"level": self.env.level.name}
