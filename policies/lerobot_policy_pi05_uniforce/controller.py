"""A checkpoint behind its processors, as ``action chunk = f(observation)``, and whether it answers in time.

The same batch conversion, preprocessor, ``select_action`` and postprocessor that ``lerobot-eval`` runs; only
the observations that would meet a full action queue are never rendered, because the policy ignores them.
"""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
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
from uniforce_vtla.errors import CheckpointError, ContractError, expected
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


class Deadlines:
    """Account of one episode's calls at a control rate.

    A call that finds k actions still queued is due when they and the present step are over: k + 1 control periods. What
    comes later leaves the robot without a new action; those control steps are counted too.

    Raises ContractError: no positive rate.
    """

    def __init__(self, control_hz: float) -> None:
        if not control_hz > 0:
            raise ContractError(expected("control rate", "above 0 Hz", control_hz, "Give the robot's rate."))
        self.period_s = 1.0 / control_hz
        self.missed = 0  # calls
        self.empty_steps = 0  # control steps without a new action
        self._latencies_s: list[float] = []

    @contextmanager
    def call(self, queued: int) -> Iterator[None]:
        """Time the block as one call that found ``queued`` actions left."""
        start = time.perf_counter()
        yield
        self.record(time.perf_counter() - start, queued)

    def record(self, latency_s: float, queued: int) -> None:
        """Account for a call that took ``latency_s``."""
        self._latencies_s.append(latency_s)
        late_s = latency_s - (queued + 1) * self.period_s
        if late_s > 0:
            self.missed += 1
            self.empty_steps += math.ceil(late_s / self.period_s)

    def facts(self) -> dict[str, float]:
        """Return calls, missed deadlines, empty control steps and latencies [ms]; nothing before the first call."""
        if not self._latencies_s:
            return {}
        ms = 1e3 * np.asarray(self._latencies_s)
        p50, p95, most = (float(np.percentile(ms, share)) for share in (50, 95, 100))
        counts = {"calls": len(ms), "missed_deadlines": self.missed, "empty_steps": self.empty_steps}
        return counts | {"latency_p50_ms": p50, "latency_p95_ms": p95, "latency_max_ms": most}


class PolicyController:
    """Drive one environment with a ``pi05_uniforce`` checkpoint.

    Args:
        checkpoint: folder with config, weights and processors.
        mounted: finger → kind of sensor the robot or scene wears.
        swap: which finger fills a slot instead, e.g. ``touch0:left``.
        asked: finger → kind the user named; only a named kind may differ from the trained one, which ``notes`` say.
        calibrations: finger → folder of a calibration that its sensor wears.
        monitor: "stop" when a sensor isn't healthy | "off".

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
    ) -> None:
        config = stored_config(Path(checkpoint))
        config.monitor = monitor
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
        with stored.misfits_named(f"processors of {folder}"):
            self._before, self._after = make_pre_post_processors(config, pretrained_path=folder)
        self.config: PI05UniforceConfig = self.policy.config
        self._deadlines = Deadlines(CONTROL_HZ)

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
                wanted[wrench_key(slot).removeprefix("observation.")] = observation[f"wrench_{finger}"]
        if self.policy.touch.monitors:
            return wanted
        unread = [name for name in TACTILE_NAMES if name.split("_")[1] not in self.reads]  # tactile_FINGER[_ref]
        return wanted | {"pixels": {k: v for k, v in observation["pixels"].items() if k not in unread}}
