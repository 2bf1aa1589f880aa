"""A checkpoint behind its processors, as ``action chunk = f(observation)``.

The same batch conversion, preprocessor, ``select_action`` and postprocessor that ``lerobot-eval`` runs; only
the observations that would meet a full action queue are never rendered, because the policy ignores them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.envs.utils import preprocess_observation

from lerobot_policy_pi05_uniforce.compatibility import check_sensors
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.deadlines import Deadlines
from lerobot_policy_pi05_uniforce.stored_policy import stored_config, stored_policy
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.keys import wrench_key

CONTROL_HZ = 30.0  # where an environment doesn't say its own rate
SHIPPED = Path(__file__).parent / "assets" / "wiping_vt"


def shipped_checkpoint() -> Path:
    """Return the folder of the tiny V+T policy shipped with the package."""
    if not (SHIPPED / "model.safetensors").exists():
        raise CheckpointError(
            expected(
                "shipped policy", str(SHIPPED / "model.safetensors"), "no such file", "Reinstall the package."
            )
        )
    return SHIPPED


class PolicyController:
    """Drive one environment with a ``pi05_uniforce`` checkpoint.

    Args:
        checkpoint: folder with config, weights and processors.
        mounted: finger → kind of sensor the robot or scene wears.
        swap: which finger fills a slot instead, e.g. ``touch0:left``.
        asked: finger → kind the user named; only a named kind may differ from the trained one.

    Attributes:
        notes: one line per slot that runs on another kind of sensor than it was trained on.

    Raises:
        CheckpointError: weights that don't fit, or a sensor that differs though nobody asked for it.
    """

    def __init__(
        self,
        checkpoint: Path,
        mounted: dict[Finger, str],
        swap: str = "",
        asked: dict[Finger, str] | None = None,
    ) -> None:
        config = stored_config(Path(checkpoint))
        config.swap = swap or config.swap
        for finger, sensor in (asked or {}).items():
            setattr(config, f"{finger}_sensor", sensor or getattr(config, f"{finger}_sensor"))
        self.notes = check_sensors(config, mounted)
        self.policy, self._before, self._after = stored_policy(config)
        self.config: PI05UniforceConfig = self.policy.config
        self._deadlines = Deadlines(CONTROL_HZ)

    @property
    def needs_true_wrench(self) -> bool:
        """Whether this is the ceiling control, which is fed the simulator's wrench."""
        return self.config.touch_input == "wrench"

    def reset(self, env: Any) -> None:
        """Forget the previous episode: action queue, issued target, cached references, latencies."""
        self.policy.reset()
        self._deadlines = Deadlines(getattr(env, "metadata", {}).get("render_fps", CONTROL_HZ))

    def facts(self) -> dict[str, float]:
        """Return calls, missed deadlines and latencies since the last reset (``Deadlines.facts``)."""
        return self._deadlines.facts()

    @torch.no_grad()
    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the next (n_action_steps, 5) absolute targets [m, m, m, rad, m]."""
        with self._deadlines.call(queued=len(self.policy._action_queue)):
            return self._issue(self._batch(observation, task))

    def _issue(self, batch: dict[str, Any]) -> np.ndarray:
        steps = [self._after(self.policy.select_action(batch)) for _ in range(self.config.n_action_steps)]
        return torch.cat(steps).numpy()

    @torch.no_grad()
    def predict(self, observation: dict[str, Any], task: str, noise: torch.Tensor) -> np.ndarray:
        """Return the whole chunk (chunk_size, 5) for given starting noise; nothing is remembered.

        ``noise`` is (1, chunk_size, max_action_dim), as the flow takes it.
        """
        chunk = self.policy.predict_action_chunk(self._batch(observation, task), noise=noise)
        return self._after(chunk)[0].numpy()

    def _batch(self, observation: dict[str, Any], task: str) -> dict[str, Any]:
        batch = preprocess_observation(self._wanted(observation))
        return self._before(batch | {"task": [task]})

    def _wanted(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Leave out marker images no slot reads; name the true wrench by slot for the ceiling control."""
        wanted = {k: v for k, v in observation.items() if not k.startswith("wrench_")}
        if self.needs_true_wrench:
            for slot, finger in self.config.finger_by_slot().items():
                wanted[wrench_key(slot).removeprefix("observation.")] = observation[f"wrench_{finger}"]
        pixels = observation["pixels"]
        keep = {k for k in pixels if not k.startswith("tactile_")} | self._tactile_names()
        return wanted | {"pixels": {k: pixels[k] for k in pixels if k in keep}}

    def _tactile_names(self) -> set[str]:
        if self.config.touch_input in ("wrench", "none"):
            return set()
        fingers = self.config.finger_by_slot().values()
        return {f"tactile_{finger}{suffix}" for finger in fingers for suffix in ("", "_ref")}


class ScriptController:
    """Drive an environment with a script that answers one action at a time."""

    def __init__(self, script: Any) -> None:
        self._script = script
        self._env: Any = None

    def reset(self, env: Any) -> None:
        """Start the script's episode."""
        self._env = env
        self._script.reset(env)

    def facts(self) -> dict[str, float]:
        """Return nothing: a script isn't timed."""
        return {}

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the script's next target as a chunk of one."""
        return np.asarray(self._script.act(self._env))[None]
