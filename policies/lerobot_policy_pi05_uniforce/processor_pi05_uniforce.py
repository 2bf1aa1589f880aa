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

from lerobot_policy_pi05_uniforce import local_tokenizer, saved_tokenizer
from lerobot_policy_pi05_uniforce.check_action import CheckActionStep
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.quantile_floor import floor_quantiles
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.keys import STATE

logger = logging.getLogger(__name__)

MEASURED_STATE = "observation.measured_state"  # the state in SI units, beside the normalised one


@ProcessorStepRegistry.register(name="uniforce_tokenizer_processor")
@dataclass
class UniforceTokenizerProcessorStep(TokenizerProcessorStep):
    """Tokenize the prompt, with nothing but the checkpoint at hand.

    The packaged tokenizer is stored by name and found again wherever the package is installed; any other is saved
    whole, as this step's state.
    """

    tokenizer_name: str | None = local_tokenizer.PACKAGED

    def __post_init__(self) -> None:
        self._files: dict[str, torch.Tensor] = {}
        self._warned = False
        if self.tokenizer_name == saved_tokenizer.SAVED:
            return  # load_state_dict brings it
        stored = self.tokenizer_name or local_tokenizer.PACKAGED
        self.tokenizer_name = local_tokenizer.location(stored)
        super().__post_init__()
        self.tokenizer_name = stored

    def get_config(self) -> dict[str, Any]:
        """Return what the pipeline's JSON holds."""
        return {**super().get_config(), "tokenizer_name": self._saved_name}

    @property
    def _saved_name(self) -> str:
        packaged = self.tokenizer_name == local_tokenizer.PACKAGED
        return local_tokenizer.PACKAGED if packaged else saved_tokenizer.SAVED

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return the tokenizer's files; nothing for the packaged one."""
        if self._saved_name == saved_tokenizer.SAVED and not self._files:
            self._files = saved_tokenizer.to_tensors(self.input_tokenizer)
        return dict(self._files)

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Take the tokenizer from its files."""
        self._files = dict(state)
        self.input_tokenizer = saved_tokenizer.from_tensors(state)

    def _tokenize_text(self, text: str | list[str]) -> dict[str, torch.Tensor]:
        if self.input_tokenizer is None:
            do = "Copy the checkpoint again, with every file of its preprocessor."
            raise CheckpointError(expected("text tokenizer", "its files in the preprocessor", "none", do))
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
