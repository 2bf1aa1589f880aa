"""The supervised row: a ResNet on reference and current image, trained end to end on the source's labels."""

from dataclasses import dataclass, field

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.baselines.cells import Predictor, fitted_row, labels, pictures
from benchmarks.baselines.end_to_end import EndToEnd, EndToEndConfig, predictor, train_end_to_end
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import POOL, Cells, Table
from uniforce_vtla.tokenizer.force_head import ForceRegressor, HeadConfig

STRIDE = 32  # of the whole network, as in every ResNet


@dataclass(frozen=True)
class ResNetConfig:
    """Sizes and training; ResNet-18's plan at a quarter of its width, so that a CPU can train nine of them."""

    width: int = 16  # channels of the first stage; ResNet-18 has 64
    # per stage; channels double and sides halve from stage to stage
    blocks: tuple[int, ...] = (2, 2, 2, 2)
    training: EndToEndConfig = field(default_factory=EndToEndConfig)


class BasicBlock(nn.Module):
    """Two 3×3 convolutions with batch norm; residual."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False),
            nn.BatchNorm2d(outputs),
        )
        self.skip: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.skip = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return (B, outputs, H / stride, W / stride)."""
        return F.relu(self.layers(maps) + self.skip(maps))


class ResNetEncoder(nn.Module):
    """Reference and current image as two channels → a latent map of stride 32."""

    def __init__(self, config: ResNetConfig) -> None:
        super().__init__()
        sizes = [config.width * 2**stage for stage in range(len(config.blocks))]
        layers: list[nn.Module] = [
            nn.Conv2d(2, config.width, 7, 2, 3, bias=False),
            nn.BatchNorm2d(config.width),
            nn.ReLU(),
            nn.MaxPool2d(3, 2, 1),
        ]
        inputs = config.width
        for stage, (outputs, blocks) in enumerate(zip(sizes, config.blocks, strict=True)):
            for index in range(blocks):
                layers.append(BasicBlock(inputs, outputs, 2 if index == 0 and stage > 0 else 1))
                inputs = outputs
        self.channels = inputs
        self.layers = nn.Sequential(*layers)

    def forward(self, reference: torch.Tensor, frames: torch.Tensor) -> torch.Tensor:
        """Return (B, F, P, L)."""
        pairs = torch.stack([reference.expand_as(frames), frames], dim=2)  # (B, F, 2, S, S)
        maps = self.layers(pairs.flatten(0, 1))  # (B·F, L, S / 32, S / 32)
        return maps.flatten(2).transpose(1, 2).unflatten(0, frames.shape[:2])


RESNET = ResNetConfig()


def resnet_row(table: Table, seeds: int, config: ResNetConfig = RESNET) -> Cells:
    return fitted_row(table, lambda source, seed: fit_resnet(source, config, seed), seeds)


def fit_resnet(source: LabelledSet, config: ResNetConfig, seed: int) -> Predictor:
    """Return a predictor trained on pictures, whose side is divisible by the stride, and on their forces."""
    shown, force_N = pictures(source), labels(source)
    model = build_resnet(config, shown.reference.shape[-1], force_N, seed)
    train_end_to_end(model, shown, force_N, config.training, seed)
    return predictor(model, config.training.device)


def build_resnet(config: ResNetConfig, side: int, force_N: torch.Tensor, seed: int) -> EndToEnd:
    """Return an untrained network whose head knows the source's force scale."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        encoder = ResNetEncoder(config)
        head = ForceRegressor(HeadConfig(channels=encoder.channels, grid=min(POOL, side // STRIDE)))
    # N; a flat axis must not divide
    head.force_scale.copy_(force_N.flatten(0, 1).std(dim=0).clamp_min(1e-3))
    return EndToEnd(encoder, head)
