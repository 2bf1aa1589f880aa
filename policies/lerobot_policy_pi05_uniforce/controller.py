"""A checkpoint behind its processors, as ``action chunk = f(observation)``, in time or not.

The same batch conversion, preprocessor, ``select_action`` and postprocessor that ``lerobot-eval``
runs. Observations that would meet a full action queue are never rendered: the policy ignores them.
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
    """Return the folder of the tiny policy shipped with the package."""
    return weights.find(SHIPPED, weights.WEIGHTS).parent


def stored_config(checkpoint: Path) -> PI05UniforceConfig:
    """Return the checked settings of a checkpoint folder, to be run on the CPU.

    Raises CheckpointError: another policy, or settings or processors that are missing, damaged or
    don't fit.
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
        mounted: finger → type of sensor mounted on the robot or in the scene.
        swap: which finger fills a slot instead, e.g. ``touch0:left``.
        asked: finger → type the user named; only a named one may differ from the trained one, which
            ``notes`` say.
        calibrations: finger → folder of its sensor's calibration.
        monitor: "stop" when a sensor isn't healthy | "off".

    Raises CheckpointError: as ``stored_config``, weights that don't fit, or a sensor that differs
    unasked.
    """

    def __init__(
        self,
        checkpoint: Path,
        mounted: dict[Finger, str],
        swap: str = "",
        asked: dict[Finger, str] | None = None,
        calibrations: dict[Finger, str] | None = None,
        monitor: str = "stop",
    ) -> None:
        config = stored_config(Path(checkpoint))
        config.monitor = monitor
        config.swap = swap or config.swap
        for finger, sensor in (asked or {}).items():
            if sensor:
                setattr(config, f"{finger}_sensor", sensor)
        for finger, folder in (calibrations or {}).items():
            setattr(config, f"{finger}_calibration", folder)
        self.notes = stored.check_sensors(config, mounted)
        for finger, kind in mounted.items():  # whose health is watched
            setattr(config, f"{finger}_sensor", kind)
        source = str(config.pretrained_path)
        self.policy = PI05UniforcePolicy.from_pretrained(source, config=config)
        with stored.misfits_named(f"processors of {source}"):
            self._before, self._after = make_pre_post_processors(config, pretrained_path=source)
        self.config = config
        self._hz = CONTROL_HZ
        self._missed = 0

    @property
    def needs_true_wrench(self) -> bool:
        """Whether this is the ceiling control, which is fed the simulator's wrench."""
        return self.config.touch.input == "wrench"

    @property
    def reads(self) -> tuple[Finger, ...]:
        """Fingers whose marker images the policy looks at."""
        if self.config.touch.input in ("wrench", "none"):
            return ()
        return tuple(dict.fromkeys(self.config.finger_by_slot().values()))

    def reset(self, env: Any) -> None:
        """Forget the previous episode: queue, target, references, missed deadlines."""
        self.policy.reset()
        self._hz = getattr(env, "metadata", {}).get("render_fps", CONTROL_HZ)
        self._missed = 0

    def facts(self) -> dict[str, float]:
        """Return how many calls since the last reset left the robot without a new action."""
        return {"missed_deadlines": self._missed}

    @torch.no_grad()
    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the next (n_action_steps, 5) absolute targets [m, m, m, rad, m]."""
        begun = time.perf_counter()
        queued = len(self.policy._action_queue)
        targets = self._issue(self._batch(observation, task))
        # due when these and the present step end
        self._missed += time.perf_counter() - begun > (queued + 1) / self._hz
        return targets

    def _issue(self, batch: dict[str, Any]) -> np.ndarray:
        targets = []
        for steps in range(self.config.n_action_steps):
            targets.append(self._after(self.policy.select_action(batch, steps)))
        return torch.cat(targets).numpy()

    def _batch(self, observation: dict[str, Any], task: str) -> dict[str, Any]:
        """Return the preprocessed observation, without marker images that nothing reads."""
        pixels = dict(observation["pixels"])
        for name in TACTILE_NAMES:
            image = pixels.pop(name, None)
            finger = name.split("_")[1]  # tactile_FINGER[_ref]
            if image is not None and finger in self.reads:
                pixels[name] = image[..., :1]  # (H, W, 1): RGB are copies of one channel
        wanted: dict[str, Any] = {"pixels": pixels}
        for name, value in observation.items():
            if name != "pixels" and not name.startswith("wrench_"):
                wanted[name] = value
        if self.needs_true_wrench:
            for slot, finger in self.config.finger_by_slot().items():
                name = wrench_key(slot).removeprefix("observation.")
                wanted[name] = observation[f"wrench_{finger}"]
        return self._before(preprocess_observation(wanted) | {"task": [task]})
