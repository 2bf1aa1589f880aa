"""The tokenizer's one entry.

Marker images of any size → mirrored, letterboxed, area-resized squares.

Training, evaluation and the policy all come through here, so they can't disagree about a resize or
a flip.
"""

import numpy as np
import torch
from torch.nn import functional as F  # noqa: N812  (its name everywhere)

from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.mirror import to_canonical

# no marker image is smaller; an (H, W, 3) image would pass for H images of three columns
MIN_SIDE_PX = 16


def prepare(
    images: np.ndarray | torch.Tensor, finger: Finger, side: int, name: str = "marker images"
) -> torch.Tensor:
    """Return (B, 1, side, side) float32 in [0, 1] from (B, H, W) or (H, W) images.

    The aspect is kept: the longer edge becomes ``side``, the rest stays black. Area averaging turns
    binary markers into grey levels that still tell where an edge lies between two pixels.

    Args:
        images: as the sensor saw them; uint8 in 0–255 or floats in [0, 1], of any size.
        finger: finger that wore the sensor; decides the mirror.
        side: pixels per side that the model takes.
        name: name of the images in an error.

    Raises ContractError: images of another form, empty, too small, NaN, or out of range.
    """
    if isinstance(images, np.ndarray) and images.dtype.kind in "buif":
        images = torch.from_numpy(np.ascontiguousarray(images))
    if not isinstance(images, torch.Tensor):
        do = "Pass marker images, one channel."
        raise ContractError(expected(name, "an array or tensor", type(images).__name__, do))
    if images.ndim == 2:
        images = images[None]
    check_images(images, name)
    canonical = to_canonical(images, finger).float()
    if images.dtype == torch.uint8:
        canonical = canonical / 255
    return letterbox(canonical[:, None], side)


def letterbox(images: torch.Tensor, side: int) -> torch.Tensor:
    """Return (B, 1, side, side) from (B, 1, H, W).

    Area-resized with the aspect kept, centred on black.
    """
    height, width = images.shape[-2:]
    longer = max(height, width)
    rows = max(1, round(side * height / longer))
    columns = max(1, round(side * width / longer))
    small = F.adaptive_avg_pool2d(images, (rows, columns))  # (B, 1, rows, columns)
    top = (side - rows) // 2
    left = (side - columns) // 2
    return F.pad(small, (left, side - columns - left, top, side - rows - top))


def check_images(images: torch.Tensor, name: str) -> torch.Tensor:
    """Return ``images`` if they are (B, H, W) uint8 or floats in [0, 1], 16 px a side or more.

    Raises ContractError: anything else.
    """
    kind = str(images.dtype).removeprefix("torch.")
    came = f"{kind} {tuple(images.shape)}"
    is_uint8 = images.dtype == torch.uint8
    if images.ndim != 3 or not (is_uint8 or images.is_floating_point()):
        do = "Pass marker images, one channel."
        raise ContractError(expected(name, "(B, H, W) uint8 or float", came, do))
    if images.numel() == 0:
        raise ContractError(expected(name, "non-empty images", came, "Check the sensor's frame."))
    if min(images.shape[1:]) < MIN_SIDE_PX:
        do = "Pass one channel of each image, not RGB."
        raise ContractError(expected(name, f"(B, H, W), {MIN_SIDE_PX} px a side or more", came, do))
    lowest, highest = images.aminmax()  # NaN if any is NaN
    if is_uint8 and int(highest) == 1:
        raise ContractError(expected(name, "uint8 of 0 and 255", "0 and 1", "Multiply by 255."))
    if not is_uint8 and not (lowest >= 0 and highest <= 1):
        raise ContractError(
            expected(name, "floats in [0, 1]", "NaN or values outside", "Divide by 255?")
        )
    return images
