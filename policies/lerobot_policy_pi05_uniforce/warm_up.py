"""Observations that mean nothing, with which a policy is run before a robot is connected."""

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.touch.controls import SHAPES
from lerobot_policy_pi05_uniforce.touch.touch_input import PAIR_KEYS
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.keys import STATE, wrench_key

WARM_LOOKS = 2  # the second one finds the reference in memory; a monitor judges from the third on
LANGUAGE = ("observation.language.tokens", "observation.language.attention_mask")


def made_up_batch(config: PI05UniforceConfig, device: torch.device) -> dict[str, Tensor]:
    """Return a batch of one, as the preprocessor of ``config`` would give it."""
    shapes = {name: feature.shape for name, feature in config.image_features.items()}
    shapes |= dict.fromkeys((STATE, MEASURED_STATE), config.input_features[STATE].shape)
    if config.touch.input == "wrench":
        shapes |= {wrench_key(slot): SHAPES["wrench"][1:] for slot in config.slots}
    batch = {name: torch.zeros(1, *shape, device=device) for name, shape in shapes.items()}
    markers = torch.zeros(1, *MARKER_IMAGE_SHAPE, device=device)
    markers[..., ::16, :] = 1.0  # a plain image would hold no markers
    batch |= {name: markers for pair in PAIR_KEYS.values() for name in pair}
    tokens = torch.zeros(1, config.tokenizer_max_length, dtype=torch.int64, device=device)
    return batch | dict(
        zip(LANGUAGE, (tokens, torch.ones_like(tokens, dtype=torch.bool)), strict=True)
    )
