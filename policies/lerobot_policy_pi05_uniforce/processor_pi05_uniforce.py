"""Pre- and post-processors: LeRobot's π0.5 pipeline with a local text tokenizer."""

import logging
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
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
from torch import Tensor
from transformers import AutoTokenizer

from lerobot_policy_pi05_uniforce.action import CheckActionStep
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.training import read_target_range
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.keys import ACTION, STATE

logger = logging.getLogger(__name__)

MEASURED_STATE = "observation.measured_state"  # the state in SI units, beside the normalised one
FOLDER = Path(__file__).parent / "text_tokenizer"
# what checkpoints store, so that a moved installation still loads
PACKAGED = "packaged:text_tokenizer"
SAVED = "saved:text_tokenizer"  # stored for a tokenizer in the preprocessor's own state file
VOCABULARY = 640  # ids for the packaged one's tokens and the image token, rounded up to 64
PALIGEMMA = "google/paligemma-3b-pt-224"  # the vocabulary of the published π0.5 weights
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


@ProcessorStepRegistry.register(name="uniforce_tokenizer_processor")
@dataclass
class UniforceTokenizerProcessorStep(TokenizerProcessorStep):
    """Tokenize the prompt, with nothing but the checkpoint at hand.

    LeRobot stores a tokenizer by name. A folder's is gone on the next machine, PaliGemma's needs
    an account. So the packaged one is found wherever the package is installed, and any other is
    saved whole, as this step's state.
    """

    tokenizer_name: str | None = PACKAGED

    def __post_init__(self) -> None:
        self._files: dict[str, Tensor] = {}
        self._warned = False
        self._last: tuple[str | list[str], dict[str, Tensor]] = ("", {})
        stored = self.tokenizer_name or PACKAGED
        if stored == PACKAGED:
            self.tokenizer_name = str(FOLDER)
        if stored != SAVED:  # else load_state_dict brings it
            super().__post_init__()
        self.tokenizer_name = stored

    def get_config(self) -> dict[str, Any]:
        """Return what the pipeline's JSON holds."""
        name = PACKAGED if self.tokenizer_name == PACKAGED else SAVED
        return {**super().get_config(), "tokenizer_name": name}

    def save_artifacts(self, _: Path) -> dict[str, str]:
        """Save no folder beside the state, as LeRobot's main would: files are in the state."""
        return {}

    def state_dict(self) -> dict[str, Tensor]:
        """Return the tokenizer's files as (n,) uint8; nothing for the packaged one."""
        if self.tokenizer_name != PACKAGED and not self._files:
            self._files = _to_tensors(self.input_tokenizer)
        return dict(self._files)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take the tokenizer from its files; nothing is looked for anywhere else."""
        self._files = dict(state)
        self._last = ("", {})
        with TemporaryDirectory() as folder:
            for name, content in state.items():
                (Path(folder) / Path(name).name).write_bytes(content.cpu().numpy().tobytes())
            self.input_tokenizer = AutoTokenizer.from_pretrained(folder, local_files_only=True)

    def _tokenize_text(self, text: str | list[str]) -> dict[str, Tensor]:
        if self.input_tokenizer is None:
            wanted = "its files in the preprocessor"
            do = "Copy the checkpoint again, with every file of its preprocessor."
            raise CheckpointError(expected("text tokenizer", wanted, "none", do))
        if self._last[1] and self._last[0] == text:  # a robot that stands still says the same
            return dict(self._last[1])
        tokens = super()._tokenize_text(text)
        self._last = (text, dict(tokens))
        if not self._warned and tokens["attention_mask"].all(dim=-1).any():
            self._warned = True
            message = "A prompt fills all %d text tokens; its end may be cut: %r"
            logger.warning(message, self.max_length, text)
        return tokens


def _to_tensors(tokenizer: Any) -> dict[str, Tensor]:
    files = {}
    with TemporaryDirectory() as folder:
        tokenizer.save_pretrained(folder)
        for path in sorted(Path(folder).iterdir()):
            if path.is_file():
                files[path.name] = torch.frombuffer(bytearray(path.read_bytes()), dtype=torch.uint8)
    return files


def floor_quantiles(stats: dict[str, dict[str, Any]] | None) -> dict[str, dict[str, Any]]:
    """Return ``stats`` with q01…q99 of state and action at least ``SPAN_FLOOR`` apart, centre kept.

    An axis that never moved in the demos then can't explode at rollout. Other keys pass untouched,
    and so do vectors without the five axes of the contract. Applying it twice changes nothing.
    """
    floored = dict(stats or {})
    for key in (STATE, ACTION):
        stat = floored.get(key, {})
        if np.size(stat.get("q01", ())) == len(SPAN_FLOOR):
            low = np.asarray(stat["q01"], dtype=np.float64)
            high = np.asarray(stat["q99"], dtype=np.float64)
            lack = np.maximum(SPAN_FLOOR - (high - low), 0.0) / 2
            floored[key] = {**stat, "q01": low - lack, "q99": high + lack}
    return floored


def make_pi05_uniforce_pre_post_processors(
    config: PI05UniforceConfig, dataset_stats: dict[str, dict[str, Any]] | None = None
) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
    """Build both pipelines; only ``observation.state`` (and absolute actions) are normalised.

    Latents and wrenches stay as they are: one sensor's statistics would hinder a swap.
    """
    stats = floor_quantiles(dataset_stats)
    mapping = config.normalization_mapping
    text_tokenizer = {"tiny": PACKAGED, "base": PALIGEMMA}[config.size]
    before = [
        RenameObservationsProcessorStep(rename_map={}),
        AddBatchDimensionProcessorStep(),
        KeepMeasuredStateStep(),
        NormalizerProcessorStep(
            features={**config.input_features, **config.output_features},
            norm_map=mapping,
            stats=stats,
            normalize_observation_keys={STATE},
        ),
        Pi05PrepareStateTokenizerProcessorStep(max_state_dim=config.max_state_dim),
        UniforceTokenizerProcessorStep(
            tokenizer_name=config.text_tokenizer_name or text_tokenizer,
            max_length=config.tokenizer_max_length,
            padding_side="right",
            padding="max_length",
        ),
        DeviceProcessorStep(device=config.device),
    ]
    # moves become targets in the policy, which checks them itself
    bounds = read_target_range(stats) if config.action.form == "absolute" else []
    after = [
        UnnormalizerProcessorStep(config.output_features, mapping, stats),
        DeviceProcessorStep(device="cpu"),
        CheckActionStep(*bounds, where=config.action.stop_outside_demos),
    ]
    return make_policy_processor_pipelines(input_steps=before, output_steps=after)
