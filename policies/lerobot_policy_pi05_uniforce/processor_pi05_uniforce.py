"""Pre- and post-processors: LeRobot's π0.5 pipeline with a local text tokenizer and state-only normalisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
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
    UnnormalizerProcessorStep,
    make_policy_processor_pipelines,
)

from lerobot_policy_pi05_uniforce.action import CheckActionStep
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.text import UniforceTokenizerProcessorStep, resolve
from uniforce_vtla.keys import ACTION, STATE

MEASURED_STATE = "observation.measured_state"  # the state in SI units, beside the normalised one
SPAN_FLOOR = (0.005, 0.005, 0.005, 0.02, 0.002)  # m, m, m, rad, m: below this a spread is noise


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


def floor_quantiles(stats: dict[str, dict[str, Any]] | None) -> dict[str, dict[str, Any]] | None:
    """Return ``stats`` with q01…q99 of state and action at least ``SPAN_FLOOR`` apart, centre kept.

    An axis that never moved in the demos then can't explode at rollout. Other keys pass untouched, and so do vectors
    that don't have the five axes of the contract. Applying it twice changes nothing.
    """
    if not stats:
        return stats
    return {key: _floor(value) if key in (STATE, ACTION) else value for key, value in stats.items()}


def _floor(stat: dict[str, Any]) -> dict[str, Any]:
    if "q01" not in stat or np.size(stat["q01"]) != len(SPAN_FLOOR):
        return stat
    low, high = (np.asarray(stat[q], dtype=np.float64) for q in ("q01", "q99"))
    lack = np.maximum(np.asarray(SPAN_FLOOR) - (high - low), 0.0) / 2
    return {**stat, "q01": low - lack, "q99": high + lack}


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
            tokenizer_name=resolve(config.text_tokenizer_name, config.size),
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
        CheckActionStep.of(stats if config.action.stop_outside_demos else None),
    ]
    return make_policy_processor_pipelines(input_steps=before, output_steps=after)
