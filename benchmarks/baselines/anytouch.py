"""AnyTouch: CLIP ViT-L/14 with sensor tokens and a video patch embedding (a still is shown three times).

Key layout from the project's code (MIT); transformers' CLIP classes are used, so the names are theirs.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from transformers import CLIPVisionConfig, CLIPVisionModel

from benchmarks.baselines.checkpoint import Tensors, load_strictly, read_tensors
from benchmarks.baselines.frozen import (
    Brightness,
    PublishedEncoder,
    PublishedRow,
    grey_to_rgb,
    measured_row,
    missing_row,
)
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.errors import CheckpointError, expected

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
SENSOR_IDS = {"gelsight": 0, "digit": 1, "gelsight_mini": 3, "duragel": 4, "universal": -1}
SENSOR_KINDS, SENSOR_TOKENS = 10, 5  # rows of the table of sensor tokens; tokens of one sensor
STILL_FRAMES = 3  # a still is repeated to fill the video patch
PREFIX = "touch_mae_model."
PARTS = ("touch_model.", "touch_projection.", "sensor_token", "video_patch_embedding.")


@dataclass(frozen=True)
class AnyTouchConfig:
    """Sizes; the default is the released model's."""

    image: int = 224  # pixels per side
    patch: int = 14  # pixels per side
    width: int = 1024  # of a token
    depth: int = 24  # blocks
    heads: int = 16  # attention heads
    mlp: int = 4096  # hidden size of a block's MLP
    projection: int = 768  # size of an output token
    # The CLIP it starts from (DataComp XL) was trained with exact GELU, OpenAI's with the quick one.
    activation: str = "gelu"

    def clip(self) -> CLIPVisionConfig:
        """Return transformers' config of the backbone."""
        return CLIPVisionConfig(
            hidden_size=self.width,
            num_hidden_layers=self.depth,
            num_attention_heads=self.heads,
            intermediate_size=self.mlp,
            image_size=self.image,
            patch_size=self.patch,
            projection_dim=self.projection,
            hidden_act=self.activation,
        )


class AnyTouchEncoder(PublishedEncoder):
    """The touch tower; tokens are projected patch tokens, those its probe averages."""

    name = "AnyTouch"

    def __init__(self, config: AnyTouchConfig | None = None, sensor: str = "universal") -> None:
        super().__init__()
        self.config = config = config or AnyTouchConfig()
        self.sensor_id = _sensor_id(sensor)
        self.input_size = (config.image, config.image)
        self.sensor_token = nn.Parameter(torch.zeros(SENSOR_KINDS, SENSOR_TOKENS, config.width))
        self.touch_model = CLIPVisionModel(config.clip()).vision_model
        size = (STILL_FRAMES, config.patch, config.patch)
        self.touch_model.embeddings.patch_embedding = nn.Conv3d(3, config.width, size, stride=size, bias=False)
        self.touch_projection = nn.Linear(config.width, config.projection, bias=False)

    def prepare(self, images: torch.Tensor, brightness: Brightness) -> torch.Tensor:
        """Return (B, 3, 224, 224) with ImageNet's mean and spread."""
        mean, std = (torch.tensor(v, device=images.device).view(3, 1, 1) for v in (IMAGENET_MEAN, IMAGENET_STD))
        return (grey_to_rgb(images, self.input_size) - mean) / std

    def token_map(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return (B, 768, 16, 16) at full size."""
        hidden = self.touch_model.pre_layrnorm(self._embed(inputs))
        hidden = self.touch_model.encoder(inputs_embeds=hidden).last_hidden_state
        tokens = self.touch_projection(hidden[:, 1 + SENSOR_TOKENS :])  # (B, P, 768)
        side = self.config.image // self.config.patch
        return tokens.transpose(1, 2).unflatten(2, (side, side))

    def _embed(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return class token, sensor tokens and patches, (B, 1 + 5 + P, D); sensor tokens have no position."""
        parts = self.touch_model.embeddings
        video = inputs[:, :, None].expand(-1, -1, STILL_FRAMES, -1, -1)  # (B, 3, frames, H, W)
        patches = parts.patch_embedding(video).flatten(2).transpose(1, 2)  # (B, P, D)
        position = parts.position_embedding.weight  # (1 + P, D)
        first = (parts.class_embedding + position[0]).expand(len(inputs), 1, -1)
        sensor = self.sensor_token[self.sensor_id].expand(len(inputs), -1, -1)
        return torch.cat([first, sensor, patches + position[1:]], dim=1)


def load_anytouch(path: Path, sensor: str = "universal", config: AnyTouchConfig | None = None) -> AnyTouchEncoder:
    """Load the touch tower from a released checkpoint.

    Raises:
        CheckpointError: missing, unreadable, an unknown sensor, or any of the tower's keys that doesn't fit.
    """
    encoder = AnyTouchEncoder(config, sensor)
    load_strictly(encoder, touch_tower(read_tensors(path, inside="model")), str(path))
    return encoder.eval().requires_grad_(False)


def touch_tower(tensors: Tensors) -> Tensors:
    """Return the tower's tensors by this module's names.

    The file also holds the vision and text towers and the autoencoder's decoder, which no probe loads. The video
    patch embedding takes the place of the still one, as in the project's own probe.
    """
    bare = {name.removeprefix(PREFIX): value for name, value in tensors.items() if name.startswith(PREFIX)}
    tower = {
        name: value
        for name, value in bare.items()
        if name.startswith(PARTS)
        and not name.startswith("sensor_token_proj")
        and name != "touch_model.embeddings.position_ids"  # counts 0 … P; older transformers stored it
    }
    video = tower.pop("video_patch_embedding.weight", None)
    still = "touch_model.embeddings.patch_embedding.weight"
    tower.pop(still, None)
    return tower if video is None else tower | {still: video}


def anytouch_row(
    table: Table, seeds: int, weights: Path | None, sensor: str = "universal", device: str = "cpu"
) -> PublishedRow:
    """Return AnyTouch's row; "n/a" without a file."""
    if weights is None:
        with torch.device("meta"):
            return missing_row(AnyTouchEncoder())
    return measured_row(load_anytouch(weights, sensor), table, seeds, f"{weights.name}, {sensor}", device)


def _sensor_id(sensor: str) -> int:
    if sensor not in SENSOR_IDS:
        raise CheckpointError(expected("AnyTouch sensor", " | ".join(SENSOR_IDS), repr(sensor), "Name one."))
    return SENSOR_IDS[sensor]
