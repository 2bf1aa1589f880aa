"""Readers of users' tactile data sets; see docs/data_readers.md."""

from uniforce_datasets.readers.genforce import ForceAxes, GenForceConfig, ReadOptions, read_genforce
from uniforce_datasets.readers.recording import LabelledRecording, PairRecording
from uniforce_datasets.readers.uniforce_pairs import (
    PairConfig,
    read_uniforce_pairs,
    write_uniforce_pairs,
)

__all__ = [
    "ForceAxes",
    "GenForceConfig",
    "LabelledRecording",
    "PairConfig",
    "PairRecording",
    "ReadOptions",
    "read_genforce",
    "read_uniforce_pairs",
    "write_uniforce_pairs",
]
