"""Form that all tactile data sets are read into: marker images with forces, or pairs of images.

Images are as the sensor saw them, never flipped; only {0, 255}. Forces follow the project's
contract: x = columns to the right, y = rows down, z = compression positive, the force of the object
on the pad.
"""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contracts import check_marker_image
from uniforce_vtla.errors import ContractError, DatasetError, expected


@dataclass(frozen=True, eq=False)
class LabelledRecording:
    """Consecutive frames of one trial of one sensor, with forces."""

    sensor: str  # kind of sensor, a free name, e.g. "gelsight" or "gelsight_d"
    indenter: str  # what was pressed
    trial: str  # name of the trial within its data set
    reference: np.ndarray  # (H, W) uint8 marker image in free air
    frames: np.ndarray  # (T, H, W) uint8 marker images
    force_N: np.ndarray  # (T, 3) float32
    # index of ``frames[0]`` within the trial: a long trial comes in several recordings
    first_frame: int = 0

    def __post_init__(self) -> None:
        """Raise DatasetError where images or forces break the form."""
        check_images(self.reference, self.frames, str(self))
        check_forces(self.force_N, len(self.frames), str(self))

    def __str__(self) -> str:
        return f"{self.sensor}/{self.indenter}/{self.trial}"


@dataclass(frozen=True, eq=False)
class PairRecording:
    """Contacts that two fingers measure at once: left frame k and right frame k are a pair."""

    sensors: tuple[str, str]  # names of the left and the right sensor
    indenter: str  # what was held
    name: str  # where in its data set it comes from
    left_reference: np.ndarray  # (H, W) uint8 marker images in free air
    right_reference: np.ndarray  # (H, W) of the right finger
    left_frames: np.ndarray  # (T, H, W) uint8 marker images
    right_frames: np.ndarray  # (T, H, W) of the right finger
    first_frame: int = 0  # index of the first pair within the indenter's frames

    def __post_init__(self) -> None:
        """Raise DatasetError where images break the form or the fingers' frames don't pair up."""
        check_images(self.left_reference, self.left_frames, f"{self}, left")
        check_images(self.right_reference, self.right_frames, f"{self}, right")
        if len(self.left_frames) != len(self.right_frames):
            counts = f"{len(self.left_frames)} and {len(self.right_frames)}"
            raise DatasetError(
                expected(str(self), "as many left as right frames", counts, "Pair them up.")
            )

    @property
    def kinds(self) -> tuple[str, str]:
        """Kinds of the left and the right sensor.

        Two of one kind are named apart by _l and _r, as folders need it.
        """
        return self.sensors[0].removesuffix("_l"), self.sensors[1].removesuffix("_r")

    def __str__(self) -> str:
        return f"{self.sensors[0]}_{self.sensors[1]}/{self.indenter}/{self.name}"


def check_images(reference: np.ndarray, frames: np.ndarray, where: str) -> None:
    """Raise DatasetError unless these are a marker image and a stack of frames of its size."""
    if getattr(frames, "ndim", 0) != 3 or len(frames) == 0 or frames.shape[1:] != reference.shape:
        wanted = f"(T, {', '.join(map(str, reference.shape))}) with T > 0"
        came = getattr(frames, "shape", type(frames).__name__)
        do = "One image size per trial, at least one frame."
        raise DatasetError(expected(f"{where}, frames", wanted, came, do))
    try:
        check_marker_image(reference, f"{where}, reference")
        check_marker_image(frames.reshape(-1, frames.shape[-1]), f"{where}, frames")
    except ContractError as error:
        raise DatasetError(str(error)) from error


def check_forces(force_N: np.ndarray, frames: int, where: str) -> None:
    """Raise DatasetError unless ``force_N`` is (frames, 3) finite float32."""
    wanted = f"({frames}, 3) float32, finite"
    came = f"{getattr(force_N, 'dtype', type(force_N).__name__)} {getattr(force_N, 'shape', '')}"
    if (
        not isinstance(force_N, np.ndarray)
        or force_N.shape != (frames, 3)
        or force_N.dtype != np.float32
    ):
        raise DatasetError(expected(f"{where}, force", wanted, came, "One force per frame."))
    if not np.isfinite(force_N).all():
        row = int(np.flatnonzero(~np.isfinite(force_N).all(axis=1))[0])
        raise DatasetError(
            expected(f"{where}, force", wanted, f"NaN or inf in row {row}", "Leave this trial out.")
        )
