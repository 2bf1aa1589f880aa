"""Pre- and post-processors: LeRobot's π0.5 pipeline with a local text tokenizer and state-only normalisation."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.lerobot_types import RobotObservation
from lerobot.policies.pi05.processor_pi05 import Pi05PrepareStateTokenizerProcessorStep
from lerobot.processor import (
    AddBatchDimensionProcessorStep,
    DeviceProcessorStep,
    NormalizerProcessorStep,
    ObservationProcessorStep,
    PolicyProcessorPipeline,
    ProcessorStepRegistry,
    RenameObservationsProcessorStep,
    TokenizerProcessorStep,
    UnnormalizerProcessorStep,
    make_policy_processor_pipelines,
)

from lerobot_policy_pi05_uniforce import local_tokenizer
from lerobot_policy_pi05_uniforce.check_action import CheckActionStep
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.quantile_floor import floor_quantiles
from uniforce_vtla.keys import STATE

logger = logging.getLogger(__name__)

MEASURED_STATE = "observation.measured_state"  # the state in SI units, beside the normalised one


@ProcessorStepRegistry.register(name="uniforce_tokenizer_processor")
@dataclass
class UniforceTokenizerProcessorStep(TokenizerProcessorStep):
    """Tokenize the prompt; the packaged tokenizer is stored by name and found again wherever it is installed."""

    tokenizer_name: str | None = local_tokenizer.PACKAGED

    def __post_init__(self) -> None:
        stored = self.tokenizer_name
        self.tokenizer_name = local_tokenizer.location(stored or local_tokenizer.PACKAGED)
        super().__post_init__()
        self.tokenizer_name = stored
        self._warned = False

    def _tokenize_text(self, text: str | list[str]) -> dict[str, torch.Tensor]:
        tokens = super()._tokenize_text(text)
        if not self._warned and bool(tokens["attention_mask"].all(dim=-1).any()):
            self._warned = True
            logger.warning("A prompt fills all %d text tokens; its end may be cut: %r", self.max_length, text)
        return tokens


@ProcessorStepRegistry.register(name="uniforce_keep_measured_state")
@dataclass
class KeepMeasuredStateStep(ObservationProcessorStep):
    """Copy the state before it is normalised: it is the first base of ``target_delta`` actions."""

    def observation(self, observation: RobotObservation) -> RobotObservation:
        """Return the observation with ``observation.measured_state`` added."""
        if STATE not in observation:
            return observation
        return {**observation, MEASURED_STATE: observation[STATE].clone()}

    def transform_features(self, features: Any) -> Any:
        """Leave the feature description alone: the copy never leaves the policy."""
        return features


def make_pi05_uniforce_pre_post_processors(
    config: PI05UniforceConfig,
    dataset_stats: dict[str, dict[str, Any]] | None = None,
) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
    """Build both pipelines; only ``observation.state`` (and absolute actions) are normalised.

    Latents and wrenches stay as they are: statistics of one sensor in front of the tokens would end the swap.
    """
    stats = floor_quantiles(dataset_stats)
    before = [
        RenameObservationsProcessorStep(rename_map={}),
        AddBatchDimensionProcessorStep(),
        KeepMeasuredStateStep(),
        NormalizerProcessorStep(
            features={**config.input_features, **config.output_features},
            norm_map=config.normalization_mapping,
            stats=stats,
            normalize_observation_keys={STATE},
        ),
        Pi05PrepareStateTokenizerProcessorStep(max_state_dim=config.max_state_dim),
        UniforceTokenizerProcessorStep(
            tokenizer_name=local_tokenizer.resolve(config.text_tokenizer_name, config.size),
            max_length=config.tokenizer_max_length,
            padding_side="right",
            padding="max_length",
        ),
        DeviceProcessorStep(device=config.device),
    ]
    after = [
        UnnormalizerProcessorStep(
            features=config.output_features, norm_map=config.normalization_mapping, stats=stats
        ),
        DeviceProcessorStep(device="cpu"),
        CheckActionStep.of(stats if config.stop_outside_demos else None),
    ]
    return make_policy_processor_pipelines(input_steps=before, output_steps=after)
