"""The wiping scene as a gymnasium environment."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import gymnasium
import numpy as np
from gymnasium import spaces

from lerobot_env_uniforce_wiping.gripper import require_gripper
from lerobot_env_uniforce_wiping.levels import CAMERA_PX, CONTROL_HZ, get_level
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from lerobot_env_uniforce_wiping.painter import Painter
from lerobot_env_uniforce_wiping.recording import CLEAR_m, TraceRecorder
from lerobot_env_uniforce_wiping.scene_params import TASK_TEXTS, SceneParams, draw_scene
from lerobot_env_uniforce_wiping.simulation import WipeSimulation
from lerobot_env_uniforce_wiping.touch import PadImages
from uniforce_vtla.contact.worn import WornSensor
from uniforce_vtla.contact.worn_in_words import Wear, wear
from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE, Finger
from uniforce_vtla.errors import ContractError, RolloutError, expected
from uniforce_vtla.evaluation.episode import EpisodeResult, EpisodeTrace, ScoreLimits, score_episode
from uniforce_vtla.keys import AXES, CAMERAS, tactile_name

if TYPE_CHECKING:
    from uniforce_vtla.force_sensor import ForceSensor


class WipeEnv(gymnasium.Env):
    """Grasp the eraser, carry it to the board, wipe the word off, lift.

    Action and state are absolute x, y, z, yaw, width of the tool (m, m, m, rad, m), base frame.
    ``reset(seed=...)`` rebuilds the scene of that seed exactly. Without a seed the environment's
    own generator draws one.

    Args:
        level: name of a locked level.
        left_sensor: sensor on the left finger, as text (``worn``) or one unit of any sensor.
        right_sensor: sensor on the right finger.
        drawn: fingers whose pads are shown; fewer are faster.
        expose_wrench: add the true pad wrenches to the observation; for ceiling controls only.
        max_steps: cut episodes earlier or later than the level does.
        render_mode: gymnasium's; pictures are always arrays.
        gripper: "hand", with the rules of the robot's, or "servo", which follows each width.
        touch_in_state: put the right finger's newtons behind the state and leave marker images out,
            for policies that take every image for a camera.
        right_calibration: folder of the right sensor's calibration; only with ``touch_in_state``.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["rgb_array"],
        "render_fps": int(CONTROL_HZ),
    }

    def __init__(
        self,
        level: str = "easy",
        left_sensor: str | WornSensor = "gelsight",
        right_sensor: str | WornSensor = "tactip",
        drawn: tuple[Finger, ...] = FINGERS,
        expose_wrench: bool = False,
        max_steps: int | None = None,
        render_mode: str | None = "rgb_array",
        gripper: str = "hand",
        touch_in_state: bool = False,
        right_calibration: str = "",
    ) -> None:
        require_gripper(gripper)
        self.level = get_level(level)
        self.gripper = gripper
        self._wear: dict[Finger, Wear] = {"left": wear(left_sensor), "right": wear(right_sensor)}
        self.sensors: dict[str, str] = {finger: worn(0).kind for finger, worn in self._wear.items()}
        self.force_sensor = force_sensor(self.sensors["right"], touch_in_state, right_calibration)
        self.drawn = drawn
        self.limits = replace(ScoreLimits(), in_band_share=self.level.in_band_share or 0.0)
        self.expose_wrench = expose_wrench
        self.render_mode = render_mode
        self.solver = SolverSettings()  # of the next episode's physics
        self._painter = Painter()
        self._max_episode_steps = max_steps or round(self.level.time_limit_s * CONTROL_HZ)
        self.task = self.task_description = TASK_TEXTS[0]
        self._sim: WipeSimulation | None = None
        self.action_space = spaces.Box(-2.0, 2.0, (len(AXES),), np.float32)
        self.observation_space = self._observation_space()

    def _observation_space(self) -> spaces.Dict:
        def picture(shape: tuple[int, int]) -> spaces.Box:
            return spaces.Box(0, 255, (*shape, 3), np.uint8)

        pixels = {name: picture((CAMERA_PX, CAMERA_PX)) for name in CAMERAS}
        state = spaces.Box(-10.0, 10.0, (len(AXES),), np.float32)
        if self.force_sensor is not None:
            state = spaces.Box(-1e3, 1e3, (len(AXES) + 3,), np.float32)
        else:
            for finger in self.drawn:
                for reference in (False, True):
                    pixels[tactile_name(finger, reference)] = picture(MARKER_IMAGE_SHAPE)
        content: dict[str, spaces.Space] = {"pixels": spaces.Dict(pixels), "agent_pos": state}
        if self.expose_wrench:
            for finger in FINGERS:
                content[f"wrench_{finger}"] = spaces.Box(-1e5, 1e5, (4,), np.float32)
        return spaces.Dict(content)

    @property
    def sim(self) -> WipeSimulation:
        """The running simulation; RolloutError before the first reset."""
        if self._sim is None:
            raise RolloutError(expected("episode", "a started one", "none", "Call reset() first."))
        return self._sim

    @property
    def scene(self) -> SceneParams:
        """Every number of the current scene, hidden ones included."""
        return self.sim.scene

    @property
    def state(self) -> np.ndarray:
        """(5,) float32 measured x, y, z, yaw, width."""
        return self.sim.measured.astype(np.float32)

    @property
    def trace(self) -> EpisodeTrace:
        """Events of the episode so far."""
        return self._recorder.trace()

    @property
    def phase(self) -> int:
        """Where the task stands: 0 before the lift, 1 carrying, 2 wiping, 3 lifted off after it."""
        return self._recorder.phase

    def true_wrench(self) -> dict[Finger, np.ndarray]:
        """Return finger → (4,) float32 fx, fy, fz N, torsion Nmm, canonical, mean of a step."""
        return {f: self.sim.pads[f].wrench.copy() for f in FINGERS}

    def marker_pair(self, finger: Finger) -> tuple[np.ndarray, np.ndarray]:
        """Return a drawn finger's reference and current marker image, (480, 640) uint8 each.

        The cameras are not painted.

        Raises:
            SensorError: a canonicalizer refuses its frame.
        """
        pad = self._touch[finger]
        return pad.reference.copy(), pad.image(self.sim).copy()

    def result(self) -> EpisodeResult:
        """Score the episode as it stands."""
        return score_episode(self.trace, self.limits)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Build the scene of ``seed`` and return its first observation."""
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        self.start(seed)
        return self.observe(), self._info()

    def scene_of(self, seed: int) -> SceneParams:
        """Return every number of the scene that ``start`` builds."""
        return draw_scene(seed, self.level.name)

    def start(self, seed: int) -> None:
        """Build the scene of ``seed`` without observing it: the fast path's reset."""
        scene = self.scene_of(seed)
        self.worn = {finger: worn(seed) for finger, worn in self._wear.items()}
        stiffness = self.worn["left"].stiffness, self.worn["right"].stiffness
        self._sim = WipeSimulation(
            scene, self.sensors["left"], self.sensors["right"], self.solver, stiffness, self.gripper
        )
        self._recorder = TraceRecorder(self._sim)
        self._steps = 0
        self.task = self.task_description = scene.task
        self._touch = {finger: PadImages(self.worn[finger], finger, seed) for finger in self.drawn}
        self._follow()
        self._painter.reset(self._sim)
        if self.force_sensor is not None:
            self.force_sensor.reset()

    def advance(self, action: np.ndarray) -> bool:
        """Take one 1/30 s step without rendering; return whether the episode has ended.

        Raises:
            ContractError: the action is not five numbers. The robot's target is held.
            RolloutError: the action is not finite. The robot's target is held.
        """
        self.sim.command(self._checked(action))
        self.sim.step()
        self._steps += 1
        self._recorder.record()
        self._follow()
        return self._wiped_and_lifted() or self._steps >= self._max_episode_steps

    def _follow(self) -> None:
        for pad in self._touch.values():
            pad.follow(self.sim)

    def _checked(self, action: np.ndarray) -> np.ndarray:
        try:
            values = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ContractError(
                expected("action", "(5,) numbers", type(action), "See keys.AXES.")
            ) from error
        if values.shape != (len(AXES),):
            raise ContractError(
                expected("action", f"({len(AXES)},) {AXES}", values.shape, "See keys.AXES.")
            )
        if not np.isfinite(values).all():
            raise RolloutError(
                expected(
                    "action", "finite numbers", values, "The target is held; check the policy."
                )
            )
        return values

    def _wiped_and_lifted(self) -> bool:
        clear = self.scene.board_height_m + self.level.layout.grasp_height_m + CLEAR_m
        clean = self.sim.ink.residual <= self.limits.residual_share
        return clean and self._recorder.phase == 3 and self.sim.measured[2] > clear

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Take one 1/30 s step; ``info`` holds ``is_success`` and ``metrics`` every time."""
        self.advance(action)
        terminated = self._wiped_and_lifted()
        truncated = not terminated and self._steps >= self._max_episode_steps
        info = self._info()
        reward = float(terminated and info["is_success"])
        return self.observe(), reward, terminated, truncated, info

    def observe(self) -> dict[str, Any]:
        """Render cameras and pads now; the arrays are the caller's own.

        Raises:
            SensorError: a canonicalizer refuses its frame, as it would on a robot.
        """
        pixels = dict(zip(CAMERAS, self._painter.render(), strict=True))
        state = self.state
        if self.force_sensor is not None:
            reading = self.force_sensor.read_markers(*self.marker_pair("right"))
            state = np.concatenate([state, reading.force_N])  # (8,)
        else:
            pixels |= self._marker_pictures()
        observation: dict[str, Any] = {"pixels": pixels, "agent_pos": state}
        if self.expose_wrench:
            for finger, wrench in self.true_wrench().items():
                observation[f"wrench_{finger}"] = wrench
        return observation

    def _marker_pictures(self) -> dict[str, np.ndarray]:
        pictures = {}
        for finger, pad in self._touch.items():
            for reference, image in ((False, pad.image(self.sim)), (True, pad.reference)):
                name = tactile_name(finger, reference)
                pictures[name] = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
        return pictures

    def _info(self) -> dict[str, Any]:
        result = self.result()
        return {
            "is_success": self._steps > 0 and result.success and self._recorder.phase == 3,
            "metrics": _flat(result),
        }

    def render(self) -> np.ndarray:
        """Return the front camera's picture."""
        return self._painter.render()[0]


def force_sensor(kind: str, wanted: bool, calibration: str) -> ForceSensor | None:
    """Return the sensor that reads the right finger's newtons; None where they aren't wanted.

    Raises ContractError: a calibration that nothing is read with; CheckpointError: one of another
    kind of sensor.
    """
    if not wanted:
        if calibration:
            do = "Set touch_in_state=true, or give it to the policy."
            raise ContractError(
                expected("right_calibration of the scene", "touch_in_state", calibration, do)
            )
        return None
    from uniforce_vtla.force_sensor import ForceSensor

    return ForceSensor(kind, "right", calibration=calibration or None)


def _flat(result: EpisodeResult) -> dict[str, float]:
    flags = {
        "clean": result.clean,
        "success": result.success,
        "slippage": result.slippage,
        "excess_force": result.excess_force,
        "failed_grasp": result.outcome == "failed_grasp",
        "residual_outcome": result.outcome == "residual",
    }
    return {name: float(value) for name, value in flags.items()} | result.metrics
