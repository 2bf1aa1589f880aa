"""Any LeRobot policy of cameras and measured state as a controller, to be scored as ours."""

from typing import Any

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from torch.nn.functional import interpolate


class StockController:
    """Loads a checkpoint by LeRobot's own factories; executes its queue, one action a look."""

    def __init__(self, folder: str) -> None:
        config = PreTrainedConfig.from_pretrained(folder)
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config).eval()
        self._before, self._after = make_pre_post_processors(config, pretrained_path=folder)
        self._sides = {key: feature.shape[1:] for key, feature in config.image_features.items()}

    def reset(self, env: Any) -> None:
        """Forget the previous episode."""
        self._policy.reset()

    def facts(self) -> dict[str, float]:
        """Return nothing: it keeps no figures."""
        return {}

    @torch.no_grad()
    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the next (1, 5) absolute target."""
        batch = preprocess_observation(observation)
        small = {
            key: interpolate(batch[key], size, mode="area") for key, size in self._sides.items()
        }
        wanted = {"observation.state": batch["observation.state"], **small, "task": [task]}
        return self._after(self._policy.select_action(self._before(wanted))).numpy()
