"""Published encoders: key layout, strict loading, input, features. Official weights were never at hand here."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.baselines.anytouch import AnyTouchConfig, AnyTouchEncoder, anytouch_row, load_anytouch
from benchmarks.baselines.frozen import (
    MEASURED,
    NOT_PRESENT,
    Brightness,
    PublishedEncoder,
    brightness_of,
    features,
    measured_row,
)
from benchmarks.baselines.t3 import Block, T3Config, T3Encoder, load_t3, t3_row
from benchmarks.baselines.unit import UniTConfig, UniTEncoder, load_unit, unit_row
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.errors import CheckpointError, ContractError

T3_TINY = T3Config(image=32, patch=8, width=16, heads=2, encoder_depth=1, trunk_depth=2)
ANYTOUCH_TINY = AnyTouchConfig(image=28, patch=7, width=16, depth=2, heads=2, mlp=32, projection=12)
UNIT_TINY = UniTConfig(size=(16, 24), channels=32, multipliers=(1, 2), attention_level=1)


Shapes = dict[str, tuple[int, ...]]


def t3_layout(config: T3Config) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """Return an encoder file and a trunk file, keys spelled out by hand."""
    d, p = config.width, config.patch
    encoder: Shapes = {"cls_token": (1, 1, d), "pos_embed": (1, (config.image // p) ** 2 + 1, d)}
    encoder |= with_bias({"patch_embed.proj": (d, 3, p, p)})
    trunk = with_bias({"norm": (d,)})
    block = {"attn.qkv": (3 * d, d), "attn.proj": (d, d), "mlp.fc1": (4 * d, d), "mlp.fc2": (d, 4 * d)}
    block |= {"norm1": (d,), "norm2": (d,)}
    for keys, depth in ((encoder, config.encoder_depth), (trunk, config.trunk_depth)):
        for n in range(depth):
            keys |= with_bias(block, f"blocks.{n}.")
    return drawn(encoder), drawn(trunk)


def anytouch_layout(config: AnyTouchConfig) -> dict[str, torch.Tensor]:
    """Return the state dict of an alignment checkpoint: our tower among other towers."""
    d, p, places = config.width, config.patch, (config.image // config.patch) ** 2 + 1
    shapes: Shapes = {
        "sensor_token": (10, 5, d),
        "video_patch_embedding.weight": (d, 3, 3, p, p),
        "touch_projection.weight": (config.projection, d),
        "touch_model.embeddings.class_embedding": (d,),
        "touch_model.embeddings.patch_embedding.weight": (d, 3, p, p),
        "touch_model.embeddings.position_embedding.weight": (places, d),
        "touch_model.embeddings.position_ids": (1, places),
        "sensor_token_proj.weight": (d, d),
        "decoder_blocks.0.weight": (d, d),
    }
    shapes |= with_bias({"pre_layrnorm": (d,), "post_layernorm": (d,)}, "touch_model.")
    layer = {f"self_attn.{name}_proj": (d, d) for name in ("q", "k", "v", "out")}
    layer |= {"mlp.fc1": (config.mlp, d), "mlp.fc2": (d, config.mlp), "layer_norm1": (d,), "layer_norm2": (d,)}
    for n in range(config.depth):
        shapes |= with_bias(layer, f"touch_model.encoder.layers.{n}.")
    others: Shapes = {"vision_model.pre_layrnorm.weight": (d,), "logit_scale": (1,)}
    return drawn({f"touch_mae_model.{name}": shape for name, shape in shapes.items()} | others)


def unit_layout(config: UniTConfig) -> dict[str, torch.Tensor]:
    """Return the state dict of a Lightning checkpoint with one channel step, one halving and attention last."""
    a, b = config.channels, config.channels * config.multipliers[1]
    own = {
        "conv_in": (a, 3, 3, 3),
        **resnet("down.0.block.0", a, a),
        **resnet("down.0.block.1", a, a),
        "down.0.downsample.conv": (a, a, 3, 3),
        **resnet("down.1.block.0", a, b),
        **resnet("down.1.block.1", b, b),
        **attention("down.1.attn.0", b),
        **attention("down.1.attn.1", b),
        **resnet("mid.block_1", b, b),
        **attention("mid.attn_1", b),
        **resnet("mid.block_2", b, b),
        "norm_out": (b,),
        "conv_out": (config.z, b, 3, 3),
    }
    others: Shapes = {"decoder.conv_in.weight": (b, 3, 3, 3), "post_quant_conv.bias": (3,), "loss.logvar": (1,)}
    others |= {"quantize.embedding.weight": (1024, 3)}
    return drawn(with_bias(own, "encoder.") | with_bias({"quant_conv": (config.embed, config.z, 1, 1)}) | others)


def resnet(name: str, inputs: int, outputs: int) -> Shapes:
    layers: Shapes = {"norm1": (inputs,), "norm2": (outputs,)}
    layers |= {"conv1": (outputs, inputs, 3, 3), "conv2": (outputs, outputs, 3, 3)}
    layers |= {"nin_shortcut": (outputs, inputs, 1, 1)} if inputs != outputs else {}
    return {f"{name}.{layer}": shape for layer, shape in layers.items()}


def attention(name: str, channels: int) -> Shapes:
    square = (channels, channels, 1, 1)
    return {f"{name}.norm": (channels,)} | {f"{name}.{part}": square for part in ("q", "k", "v", "proj_out")}


def with_bias(layers: Shapes, prefix: str = "") -> Shapes:
    """Return the shapes of each layer's weight and bias."""
    weights = {f"{prefix}{name}.weight": shape for name, shape in layers.items()}
    return weights | {f"{prefix}{name}.bias": shape[:1] for name, shape in layers.items()}


def drawn(shapes: Shapes) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {name: 0.3 * torch.randn(shape, generator=generator) for name, shape in shapes.items()}


@pytest.fixture
def t3_folder(tmp_path: Path) -> Path:
    encoder, trunk = t3_layout(T3_TINY)
    (tmp_path / "encoders").mkdir()
    torch.save(encoder, tmp_path / "encoders" / "mini.pth")
    torch.save(trunk, tmp_path / "trunk.pth")
    return tmp_path


@pytest.fixture
def anytouch_file(tmp_path: Path) -> Path:
    content = {"model": anytouch_layout(ANYTOUCH_TINY), "args": argparse.Namespace(lr=1e-3), "epoch": 19}
    torch.save(content, tmp_path / "checkpoint.pth")
    return tmp_path / "checkpoint.pth"


@pytest.fixture
def unit_file(tmp_path: Path) -> Path:
    torch.save({"state_dict": unit_layout(UNIT_TINY), "epoch": 3}, tmp_path / "unit.ckpt")
    return tmp_path / "unit.ckpt"


Loader = Callable[[], PublishedEncoder]


@pytest.fixture(params=["t3_folder", "anytouch_file", "unit_file"])
def loader(request: pytest.FixtureRequest) -> Loader:
    path = request.getfixturevalue(request.param)
    return {
        "t3_folder": lambda: load_t3(path, "mini", T3_TINY),
        "anytouch_file": lambda: load_anytouch(path, "gelsight_mini", ANYTOUCH_TINY),
        "unit_file": lambda: load_unit(path, UNIT_TINY),
    }[request.param]


def test_a_file_of_the_official_layout_loads_and_encodes(loader: Loader, table: Table) -> None:
    encoder, labelled = loader(), table.frozen["tactip"]
    z = features(encoder, labelled)
    assert z.shape[:3] == (8, 4, 16) and bool(z.isfinite().all())
    assert z.flatten(0, 1).std(dim=0).max() > 1e-4  # frames differ
    assert torch.equal(features(loader(), labelled), z)
    blind = replace(labelled, force_N=np.full_like(labelled.force_N, np.nan))
    assert torch.equal(features(encoder, blind), z)


def test_a_loaded_encoder_makes_a_row(t3_folder: Path, table: Table) -> None:
    row = measured_row(load_t3(t3_folder, "mini", T3_TINY), table, 1, "mini + trunk")
    assert row.status == MEASURED and row.cells is not None
    assert set(row.cells) == {"G->G", "G->T", "T->G", "T->T"}
    assert row.as_dict()["weights"] == "mini + trunk"
    with pytest.raises(ContractError, match="seeds"):
        measured_row(load_t3(t3_folder, "mini", T3_TINY), table, 0, "mini")


@pytest.mark.parametrize(
    ("make", "params", "gflops"),
    [
        # ViT-B/16 without head: 85.8 M parameters, 17.6 G multiply-adds
        (lambda t: t3_row(t, 1, None), 85_798_656, (34, 37)),
        # ViT-L/14: 303.2 M parameters, about 81 G multiply-adds; + sensor tokens, projection, video patches
        (lambda t: anytouch_row(t, 1, None), 305_221_632, (160, 170)),
        (lambda t: unit_row(t, 1, None), 25_179_663, (45, 60)),
    ],
)
def test_without_weights_a_row_says_so_and_gives_its_full_size(make, params, gflops, table) -> None:
    row = make(table)
    assert row.status == NOT_PRESENT and row.cells is None and row.facts["weights"] is None
    assert row.facts["params"] == params
    assert gflops[0] * 1e9 < row.facts["flops_per_frame"] < gflops[1] * 1e9


def test_every_key_that_does_not_fit_is_named(t3_folder: Path, anytouch_file: Path, unit_file: Path) -> None:
    trunk = torch.load(t3_folder / "trunk.pth")
    trunk["extra.weight"] = trunk.pop("norm.weight")
    torch.save(trunk, t3_folder / "trunk.pth")
    with pytest.raises(CheckpointError, match=r"missing norm\.weight; unexpected extra\.weight"):
        load_t3(t3_folder, "mini", T3_TINY)
    content = {"model": anytouch_layout(ANYTOUCH_TINY)}
    del content["model"]["touch_mae_model.video_patch_embedding.weight"]
    torch.save(content, anytouch_file)
    with pytest.raises(CheckpointError, match=r"missing touch_model\.embeddings\.patch_embedding\.weight"):
        load_anytouch(anytouch_file, config=ANYTOUCH_TINY)
    tensors = unit_layout(UNIT_TINY) | {"colorize": torch.zeros(1)}
    torch.save({"state_dict": tensors}, unit_file)
    with pytest.raises(CheckpointError, match="unexpected colorize"):
        load_unit(unit_file, UNIT_TINY)
    with pytest.raises(CheckpointError, match=r"is .*, not"):
        torch.save({"state_dict": unit_layout(replace(UNIT_TINY, channels=64))}, unit_file)
        load_unit(unit_file, UNIT_TINY)


def test_t3_never_picks_an_encoder_by_itself(t3_folder: Path, table: Table) -> None:
    (t3_folder / "encoders" / "mini.pth").rename(t3_folder / "encoders" / "gs_green.pth")
    for asked in ("mini", ""):
        with pytest.raises(CheckpointError, match="one of gs_green"):
            load_t3(t3_folder, asked, T3_TINY)
    with pytest.raises(CheckpointError, match="Name the encoder"):
        t3_row(table, 1, t3_folder)


def test_files_that_hold_no_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "unit.ckpt"
    with pytest.raises(CheckpointError, match="a file"):
        load_unit(path, UNIT_TINY)
    contents: list[object] = [{"weights": {}}, {"state_dict": {"a": 1}}, [1]]
    for content in contents:
        torch.save(content, path)
        with pytest.raises(CheckpointError, match="under 'state_dict'"):
            load_unit(path, UNIT_TINY)
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(CheckpointError, match="tensors only"):
        load_unit(path, UNIT_TINY)


def test_anytouch_takes_the_video_patch_embedding_and_the_named_sensor(anytouch_file: Path) -> None:
    tensors = anytouch_layout(ANYTOUCH_TINY)
    encoder = load_anytouch(anytouch_file, "gelsight_mini", ANYTOUCH_TINY)
    kept = encoder.state_dict()["touch_model.embeddings.patch_embedding.weight"]
    assert torch.equal(kept, tensors["touch_mae_model.video_patch_embedding.weight"])
    image = torch.rand(1, 32, 32)
    other = load_anytouch(anytouch_file, "universal", ANYTOUCH_TINY)
    assert not torch.allclose(encoder(image, Brightness(0, 1)), other(image, Brightness(0, 1)))
    with pytest.raises(CheckpointError, match="AnyTouch sensor: expected"):
        load_anytouch(anytouch_file, "tactip", ANYTOUCH_TINY)


def test_inputs_are_prepared_as_each_project_does(table: Table) -> None:
    image = torch.zeros(1, 128, 128)
    image[:, 16:112] = 0.5  # a 4:3 marker image between black bars
    with torch.device("meta"):
        t3, anytouch, unit = T3Encoder(), AnyTouchEncoder(), UniTEncoder()
    seen = unit.prepare(image, Brightness(0, 1))
    assert seen.shape == (1, 3, 128, 160) and seen.min() == seen.max() == 0.5  # no bar left
    seen = t3.prepare(image, Brightness(0.5, 0.25))
    assert seen.shape == (1, 3, 224, 224)
    assert seen[0, :, 112, 112].tolist() == [0, 0, 0] and seen[0, 0, 0, 0] == -2
    seen = anytouch.prepare(image, Brightness(0.5, 0.25))
    channels = [(0.5 - 0.485) / 0.229, 0.044 / 0.224, 0.094 / 0.225]
    assert seen[0, :, 112, 112].tolist() == pytest.approx(channels)
    frames = table.frozen["tactip"].frames / 255
    assert brightness_of(table.frozen["tactip"]).mean == pytest.approx(frames.mean(), abs=1e-4)


def test_t3s_block_is_the_standard_transformer_block() -> None:
    block = Block(T3_TINY, eps=1e-6)
    usual = {"activation": "gelu", "batch_first": True, "norm_first": True}
    layer = torch.nn.TransformerEncoderLayer(16, 2, 64, dropout=0, layer_norm_eps=1e-6, **usual)
    names = {"attn.qkv.": "self_attn.in_proj_", "attn.proj.": "self_attn.out_proj."}
    names |= {"mlp.fc1.": "linear1.", "mlp.fc2.": "linear2.", "norm1.": "norm1.", "norm2.": "norm2."}
    renamed = {}
    for key, value in block.state_dict().items():
        old = next(prefix for prefix in names if key.startswith(prefix))
        renamed[key.replace(old, names[old])] = value
    layer.load_state_dict(renamed)
    tokens = torch.randn(2, 5, 16)
    torch.testing.assert_close(block(tokens), layer(tokens))


def test_a_meta_model_has_no_features(table: Table) -> None:
    with torch.device("meta"):
        encoder = UniTEncoder(UNIT_TINY)
    with pytest.raises(ContractError, match="loaded weights"):
        features(encoder, table.frozen["tactip"])
