"""Readers of users' tactile data sets; see docs/data_readers.md."""

from uniforce_datasets.readers.force_axes import ForceAxes
from uniforce_datasets.readers.fusion_keys import FusionKeys
from uniforce_datasets.readers.genforce import GenForceConfig, read_genforce
from uniforce_datasets.readers.labelled import (
    WindowConfig,
    of_indenters,
    of_sensor,
    shear_agreement,
    to_labelled_set,
    to_pair_arrays,
)
from uniforce_datasets.readers.recording import LabelledRecording, PairRecording
from uniforce_datasets.readers.sets import ForceSet, PairSet, force_set, pair_set
from uniforce_datasets.readers.tactile_fusion import FusionConfig, read_tactile_fusion
from uniforce_datasets.readers.taf import TafConfig, read_taf_lerobot
from uniforce_datasets.readers.taf_mcap import McapConfig, read_taf_mcap
from uniforce_datasets.readers.trial import ReadOptions
from uniforce_datasets.readers.uniforce_pairs import PairConfig, read_uniforce_pairs, write_uniforce_pairs

__all__ = [
    "ForceAxes",
    "ForceSet",
    "FusionConfig",
    "FusionKeys",
    "GenForceConfig",
    "LabelledRecording",
    "McapConfig",
    "PairConfig",
    "PairRecording",
    "PairSet",
    "ReadOptions",
    "TafConfig",
    "WindowConfig",
    "force_set",
    "of_indenters",
    "of_sensor",
    "pair_set",
    "read_genforce",
    "read_tactile_fusion",
    "read_taf_lerobot",
    "read_taf_mcap",
    "read_uniforce_pairs",
    "shear_agreement",
    "to_labelled_set",
    "to_pair_arrays",
    "write_uniforce_pairs",
]
