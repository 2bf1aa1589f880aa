"""A checkpoint behind its processors, as ``action chunk = f(observation)``, and whether it answers in time.

The same batch conversion, preprocessor, ``select_action`` and postprocessor that ``lerobot-eval`` runs; only
the observations that would meet a full action queue are never rendered, because the policy ignores them.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.factory import make_pre_post_processors

from lerobot_policy_pi05_uniforce import checkpoint as stored
from lerobot_policy_pi05_uniforce import weights
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import PI05UniforcePolicy
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import TACTILE_NAMES, wrench_key

CONTROL_HZ = 30.0  # where an environment doesn't say its own rate
SHIPPED = Path(__file__).parent / "assets" / "wiping_vt"


def shipped_checkpoint() -> Path:
    """Return the folder of the tiny V+T policy shipped with the package."""
    return weights.find(SHIPPED, weights.WEIGHTS).parent


def stored_config(checkpoint: Path) -> PI05UniforceConfig:
    """Return the checked settings of a checkpoint folder, to be run on the CPU.

    Raises CheckpointError: another policy, or settings or processors that are missing, damaged or don't fit.
    """
    file = weights.find(checkpoint, weights.CONFIG)
    stored.check_settings(read_object(file, CheckpointError), str(checkpoint))
    stored.check_processors(checkpoint)
    with stored.misfits_named(str(checkpoint)):
        config = PreTrainedConfig.from_pretrained(checkpoint)
    assert isinstance(config, PI05UniforceConfig), "check_settings has seen its type"
    config.device = "cpu"
    config.pretrained_path = checkpoint
    return config


class PolicyController:
    """Drive one environment with a ``pi05_uniforce`` checkpoint.

    Args:
        checkpoint: folder with config, weights and processors.
        mounted: finger → kind of sensor the robot or scene wears.
        swap: which finger fills a slot instead, e.g. ``touch0:left``.
        asked: finger → kind the user named; only a named kind may differ from the trained one, which ``notes`` say.
        calibrations: finger → folder of a calibration that its sensor wears.
        monitor: "stop" when a sensor isn't healthy | "off".
        grip: "read" | "held" | "", see the config's.

    Raises CheckpointError: as ``stored_config``, weights that don't fit, or a sensor that differs unasked.
    """

    def __init__(
        self,
        checkpoint: Path,
        mounted: dict[Finger, str],
        swap: str = "",
        asked: dict[Finger, str] | None = None,
        calibrations: dict[Finger, str] | None = None,
        monitor: str = "stop",
        grip: str = "",
    ) -> None:
        config = stored_config(Path(checkpoint))
        config.monitor, config.grip = monitor, grip
        config.swap = swap or config.swap
        for finger, sensor in (asked or {}).items():
            setattr(config, f"{finger}_sensor", sensor or getattr(config, f"{finger}_sensor"))
        for finger, folder in (calibrations or {}).items():
            setattr(config, f"{finger}_calibration", folder)
        self.notes = stored.check_sensors(config, mounted)
        for finger, kind in mounted.items():  # whose health is watched
            setattr(config, f"{finger}_sensor", kind)
        folder = str(config.pretrained_path)
        self.policy = PI05UniforcePolicy.from_pretrained(folder, config=config)
        self.notes = [*self.notes, *self.policy.touch.notes]
        with stored.misfits_named(f"processors of {folder}"):
            self._before, self._after = make_pre_post_processors(config, pretrained_path=folder)
        self.config: PI05UniforceConfig = self.policy.config
        self._hz, self._missed = float(CONTROL_HZ), 0

    @property
    def needs_true_wrench(self) -> bool:
        """Whether this is the ceiling control, which is fed the simulator's wrench."""
        return self.config.touch.input == "wrench"

    @property
    def reads(self) -> tuple[Finger, ...]:
        """Fingers whose marker images the policy looks at."""
        images = self.config.touch.input not in ("wrench", "none")
        return tuple(dict.fromkeys(self.config.finger_by_slot().values())) if images else ()

    def reset(self, env: Any) -> None:
        """Forget the previous episode: action queue, issued target, cached references, missed deadlines."""
        self.policy.reset()
        self._hz, self._missed = getattr(env, "metadata", {}).get("render_fps", CONTROL_HZ), 0

    def facts(self) -> dict[str, float]:
        """Return how many calls since the last reset left the robot without a new action."""
        return {"missed_deadlines": self._missed}

    @torch.no_grad()
    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the next (n_action_steps, 5) absolute targets [m, m, m, rad, m]."""
        begun, queued = time.perf_counter(), len(self.policy._action_queue)
        targets = self._issue(self._batch(observation, task))
        # due when these and the present step end
        self._missed += time.perf_counter() - begun > (queued + 1) / self._hz
        return targets

    def _issue(self, batch: dict[str, Any]) -> np.ndarray:
        count = self.config.n_action_steps
        targets = [self._after(self.policy.select_action(batch, steps)) for steps in range(count)]
        return torch.cat(targets).numpy()

    @torch.no_grad()
    def predict(self, observation: dict[str, Any], task: str, noise: torch.Tensor) -> np.ndarray:
        """Return the whole chunk (chunk_size, 5) for starting ``noise`` (1, chunk_size, max_action_dim)."""
        chunk = self.policy.predict_action_chunk(self._batch(observation, task), noise=noise)
        return self._after(chunk)[0].numpy()

    def _batch(self, observation: dict[str, Any], task: str) -> dict[str, Any]:
        batch = preprocess_observation(self._wanted(observation))
        return self._before(batch | {"task": [task]})

    def _wanted(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Leave out marker images that neither a slot nor a monitor reads; name the ceiling control's true wrench."""
        wanted = {k: v for k, v in observation.items() if not k.startswith("wrench_")}
        if self.needs_true_wrench:
            for slot, finger in self.config.finger_by_slot().items():
                wanted[wrench_key(slot).removeprefix("observation.")] = observation[
                    f"wrench_{finger}"
                ]
        if self.policy.touch.is_watched:
            return wanted
        # tactile_FINGER[_ref]
        unread = [name for name in TACTILE_NAMES if name.split("_")[1] not in self.reads]
        return wanted | {
            "pixels": {k: v for k, v in observation["pixels"].items() if k not in unread}
        }
