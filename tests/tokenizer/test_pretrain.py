import itertools
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from accelerate.state import AcceleratorState

from benchmarks.trust.injuries import edit_json
from uniforce_cli.pretrain import PRESETS, PretrainCommand, main, recorded_pairs
from uniforce_datasets.readers.recording import PairRecording
from uniforce_datasets.readers.uniforce_pairs import write_uniforce_pairs
from uniforce_vtla.arguments import parse, read
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import CheckpointError, ContractError, DatasetError
from uniforce_vtla.results_file import only_writer
from uniforce_vtla.tokenizer import worn_heads
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead, HeadTrainingConfig
from uniforce_vtla.tokenizer.losses import Side, equilibrium, gradient_pyramid, kl, reconstruction
from uniforce_vtla.tokenizer.model import Posterior, build_model
from uniforce_vtla.tokenizer.pair_cache import PairCache, build_cache, draw_finger, rigs
from uniforce_vtla.tokenizer.pretrain import Pretraining, learning_rate, pair_loss
from uniforce_vtla.tokenizer.settings import LossConfig, PairCacheConfig, PretrainSettings
from uniforce_vtla.tokenizer.worn_heads import WornSequences

SMALL_DATA = PairCacheConfig(side=32, units=2, pairs_per_unit=4, units_per_shard=1)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return PairCache(tmp_path_factory.mktemp("pairs"), SMALL_DATA)


@pytest.fixture
def settings(tiny):
    drawn = {"units_per_batch": 2, "pairs_per_unit": 2}
    return PretrainSettings(tiny, data=SMALL_DATA, steps=6, warmup_steps=2, save_every=2, **drawn)


@pytest.fixture
def pretraining(settings, data, tmp_path):
    """Return a function: a run in a folder, some settings changed."""
    return lambda name="run", **changes: Pretraining(
        replace(settings, **changes), tmp_path / name, data
    )


def test_pairs_come_mirrored_and_in_range(data):
    pairs = data.draw(np.random.default_rng(0), units=3, pairs=2)
    assert pairs.left_reference.shape == (3, 1, 32, 32)
    assert pairs.right_current.shape == (6, 1, 32, 32)
    stored = torch.from_numpy(data.arrays["right_reference"] / np.float32(255)).flip(-1)
    assert any(torch.equal(pairs.right_reference[0, 0], image) for image in stored)
    assert pairs.left_current.max() <= 1


def test_cache_resumes_and_refuses_another_recipe(tmp_path):
    build_cache(tmp_path, SMALL_DATA)
    shard = tmp_path / "shard_001.npz"
    kept = shard.read_bytes()
    shard.unlink()
    # as a cache from before that option
    edit_json(tmp_path / "config.json", lambda stored: stored.pop("imbalance"))
    build_cache(tmp_path, SMALL_DATA)
    assert shard.read_bytes() == kept
    for other in ({"seed": 9}, {"imbalance": 0.1}):
        with pytest.raises(DatasetError, match="another folder"):
            build_cache(tmp_path, replace(SMALL_DATA, **other))


def test_a_run_from_before_an_option_goes_on(pretraining, settings, tmp_path):
    pretraining().run(until=2)

    def forget_options(recipe):
        del recipe["pairs"], recipe["model"]["warp"], recipe["data"]["left_out"]
        del recipe["loss"]["equilibrium_scale"]

    edit_json(tmp_path / "run" / "recipe.json", forget_options)
    assert pretraining().step == 2
    others = {"pairs": "elsewhere", "loss": replace(settings.loss, equilibrium_scale="per_unit")}
    others["learning_rate"] = 0.5
    for name, other in others.items():
        with pytest.raises(DatasetError, match=f"another.*{name}"):
            pretraining(**{name: other})
    edit_json(tmp_path / "run" / "recipe.json", lambda recipe: recipe.update(model=3))
    with pytest.raises(DatasetError, match=r"another.*model"):
        pretraining()


def test_a_tiny_batch_is_overfitted(data, tiny):
    model = build_model(tiny, 0)
    pairs = data.draw(np.random.default_rng(0), units=2, pairs=4)
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    config = LossConfig(equilibrium_weight=0.1)
    losses = []
    torch.manual_seed(0)
    for step in range(260):  # markers move little on 32 px: it leaves copying after some 150
        loss, parts, _ = pair_loss(model, pairs, config, step)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    reconstructed = sum(parts[f"recon_{b}"].item() for b in ("LL", "LR", "RL", "RR"))
    assert losses[-1] < 0.8 * losses[0] and reconstructed < 0.8 * parts["copied"].item()


def test_resumed_run_equals_an_uninterrupted_one(pretraining, settings, tmp_path):
    whole = pretraining("whole").run()
    pretraining().run(until=4)
    resumed = pretraining()
    assert resumed.step == 4
    assert resumed.run().hash == whole.hash
    assert len((tmp_path / "run" / "log.csv").read_text().splitlines()) == settings.steps + 1
    assert Tokenizer.from_pretrained(tmp_path / "run" / "tokenizer").hash == whole.hash


def test_a_run_may_start_from_another_ones_weights(pretraining, settings, tmp_path):
    first = pretraining("first").run(until=2)
    init = str(first.save(tmp_path / "weights"))
    assert pretraining("second", init=init).tokenizer().hash == first.hash
    wider = replace(settings.model, width=2 * settings.model.width)
    with pytest.raises(ContractError, match="Give it the same sizes"):
        pretraining("third", init=init, model=wider)
    pretraining("second", init=init).run(until=1)
    shutil.rmtree(init)  # what it started from is no longer needed
    assert pretraining("second", init=init).step == 1


def test_learning_rate_rises_then_falls(settings):
    rates = [learning_rate(s, settings) for s in range(settings.steps + 1)]
    assert rates[0] < rates[1] == settings.learning_rate and rates[-1] == pytest.approx(2e-5)


def test_equilibrium_variants_on_a_known_gap():
    by_patch, by_level = (
        partial(equilibrium, config=LossConfig(equilibrium=name)) for name in ("patch", "levels")
    )
    left, right = torch.zeros(1, 16, 6), torch.zeros(1, 16, 6)
    right[0, 0], right[0, 1] = 1, -1  # two neighbours cancel in the total
    assert by_patch(left, right) == pytest.approx(12 / 16)
    assert by_level(left, right) == pytest.approx(2 * 12 / 16)
    same = torch.full((1, 16, 6), 0.5)  # every level sees it
    assert by_level(left, same) == pytest.approx(3 * by_patch(left, same))


def test_equilibrium_in_a_units_own_size_knows_no_gain():
    torch.manual_seed(0)
    left = torch.randn(8, 16, 6)
    right = left + 0.3 * torch.randn(8, 16, 6)
    config = LossConfig(equilibrium="levels", equilibrium_scale="per_unit")
    in_own_size = partial(equilibrium, config=config, per_unit=4)
    plain = float(in_own_size(left, right))
    weak = torch.cat([0.5 * right[:4], 2.0 * right[4:]])  # two units that answer otherwise
    assert in_own_size(0.01 * left, weak) == pytest.approx(plain, rel=1e-3)
    torn = torch.cat([right[:2], 0.5 * right[2:]])
    assert in_own_size(left, torn) > 1.5 * plain
    absolute = replace(config, equilibrium_scale="absolute")
    assert equilibrium(left, weak, absolute) > 1.5 * equilibrium(left, right, absolute)


def test_kl_is_zero_for_the_prior_only():
    prior = Posterior(torch.zeros(1, 4, 6), torch.zeros(1, 4, 6))
    assert kl(prior) == 0
    assert kl(prior._replace(mean=prior.mean + 1)) == pytest.approx(0.5)


def test_changed_pixels_count_more_when_asked():
    reference = torch.zeros(1, 1, 16, 16)
    current = reference.clone()
    current[..., :2] = 1
    side = Side(reference, current, Posterior(reference, reference))
    plain, weighted = (
        reconstruction(reference, side, LossConfig(changed_pixel_weight=w, perceptual_weight=0))
        for w in (0, 9)
    )
    assert weighted == pytest.approx(10 * plain.item())


def test_gradient_pyramid_sees_edges_only():
    image = torch.rand(1, 1, 16, 16)
    assert gradient_pyramid(image + 0.3, image, 3) == pytest.approx(0, abs=1e-6)
    assert gradient_pyramid(image.flip(-1), image, 3) > 0.05


def test_the_log_says_what_data_cost_and_strips_are_drawn(pretraining, tmp_path):
    pretraining(strips_every=2, steps=2).run()
    assert "data_share" in (tmp_path / "run" / "log.csv").read_text().splitlines()[0]
    assert [p.name for p in (tmp_path / "run" / "strips").iterdir()] == ["step_000002.png"]


@pytest.fixture
def fresh_accelerator():
    """One process has one precision: forget it before and after."""
    AcceleratorState._reset_state(reset_partial_state=True)
    yield
    AcceleratorState._reset_state(reset_partial_state=True)


def test_bf16_trains(pretraining, fresh_accelerator):
    assert np.isfinite(pretraining(mixed_precision="bf16").train_step()["loss"])


MODEL = "side=32 patch=8 width=16 heads=2"
DATA = "side=32 units=2 units_per_shard=1 pairs_per_unit=2"


def run_command(folder, *more, heads="none"):
    sizes = [f"run.model.{size}" for size in MODEL.split()]
    sizes += [f"run.data.{size}" for size in DATA.split()]
    folders = [f"cache={folder / 'pairs'}", f"out={folder / 'out'}", f"heads={heads}"]
    return main([*sizes, "run.pairs_per_unit=2", *folders, *more])


def test_command_trains_continues_and_leaves_a_loadable_tokenizer(tmp_path):
    log = tmp_path / "out" / "log.csv"
    hashes = []
    for steps in (2, 3):
        assert run_command(tmp_path, f"run.steps={steps}") == 0
        hashes.append(Tokenizer.from_pretrained(tmp_path / "out" / "tokenizer").hash)
    assert hashes[0] != hashes[1]
    with only_writer(log):
        assert run_command(tmp_path, "run.steps=4") == 2
    assert len(log.read_text().splitlines()) == 4


def test_command_trains_on_recorded_pairs_and_says_where_there_are_none(tmp_path, capsys):
    """A left finger whose marker moves right is seen mirrored by the right one: in the canonical
    frame both agree."""
    free, moved = np.zeros((2, 1, 480, 640), np.uint8)
    free[:, 200:280, 200:280] = 255
    moved[:, 200:280, 260:340] = 255
    for indenter, contacts in (("ball", 3), ("bar", 1)):
        left = np.repeat(moved, contacts, axis=0)
        references = free[0], free[0, :, ::-1]
        recording = PairRecording(FINGERS, indenter, "", *references, left, left[..., ::-1])
        write_uniforce_pairs(tmp_path, recording, "own")
    pairs = recorded_pairs(str(tmp_path), 32).draw(np.random.default_rng(0), units=3, pairs=2)
    assert pairs.left_reference.shape == (3, 1, 32, 32)
    assert pairs.right_current.shape == (6, 1, 32, 32)
    assert torch.equal(pairs.left_current, pairs.right_current)
    assert torch.equal(pairs.left_reference, pairs.right_reference)
    assert not torch.equal(pairs.left_current[0], pairs.left_reference[0])
    assert run_command(tmp_path / "run", "run.steps=2", f"run.pairs={tmp_path}") == 0
    assert not (tmp_path / "run" / "pairs").exists()  # nothing is drawn
    (tmp_path / "empty").mkdir()
    assert run_command(tmp_path / "other", f"run.pairs={tmp_path / 'empty'}") == 2
    assert "collection_log.txt, got none" in capsys.readouterr().err


def test_command_leaves_a_head_beside_its_tokenizer(tmp_path, monkeypatch):
    """It reads that tokenizer's latents, wherever a tokenizer's folder is named."""
    few = WornSequences(units=1, moving=1, held=15)
    monkeypatch.setattr(worn_heads, "WornSequences", lambda: few)
    monkeypatch.setattr(worn_heads, "WORN_HEADS", HeadTrainingConfig(steps=3, batch=4))
    out = tmp_path / "out"
    assert run_command(tmp_path, "run.steps=1", heads="tactip") == 0
    tokenizer = Tokenizer.from_pretrained(out / "tokenizer")
    head = ForceHead.from_pretrained("tactip", out / "tokenizer")
    assert (head.source, head.tokenizer_hash) == ("tactip", tokenizer.hash)
    with pytest.raises(CheckpointError, match="force_head_uskin"):
        ForceHead.from_pretrained("uskin", out / "tokenizer")


def test_the_family_replaces_cameras_only_and_only_its_share():
    rng = np.random.default_rng(0)

    def drawn(kind, **share):
        config = PairCacheConfig(**share)
        return [draw_finger(rng, kind, config) for _ in range(200)]

    of_family = [s for s in drawn("gelsight", family_share=0.5) if isinstance(s, VirtualSensor)]
    assert 60 < len(of_family) < 140
    assert {*drawn("uskin", family_share=1.0)} == {"uskin"} and {*drawn("tactip")} == {"tactip"}


@pytest.mark.parametrize(
    "left_out, seen",
    [
        ("", {"gelsight", "flat", "uskin", "tactip", "dome"}),
        ("gelsight", {"uskin", "tactip", "dome"}),
        ("uskin", {"gelsight", "flat", "tactip", "dome"}),
    ],
)
def test_what_each_tokenizer_saw(left_out, seen):
    """A kind that is left out is left out with the family around it; the TacTip, which demos wear,
    never is."""
    config = PairCacheConfig(family_share=0.5, left_out=left_out)
    rng, drawn = np.random.default_rng(3), set()
    for _ in range(40):
        for finger in itertools.chain(*rigs(config)):
            sensor = draw_finger(rng, finger, config)
            drawn.add(getattr(sensor, "name", sensor).partition("_")[0])
    assert drawn == seen


def test_leaving_a_kind_out_draws_as_many_pairs(tmp_path):
    config = replace(SMALL_DATA, left_out="uskin")
    assert len(PairCache(tmp_path, config).arrays["left_reference"]) == 2 * SMALL_DATA.units


def preset(name, *more):
    return read(PretrainCommand, [f"preset={name}", *more], PRESETS)[0]


def test_each_stage_of_small_starts_from_what_the_one_before_left():
    stages = [preset(name) for name in ("small_draw", "small_agree", "small")]
    for earlier, later in itertools.pairwise(stages):
        assert later.run.init == f"{earlier.out}/tokenizer" and later.run.model == earlier.run.model
        assert later.run.data == earlier.run.data or later.cache != earlier.cache
    assert stages[2].run.data.flat_share > stages[1].run.data.flat_share > 0.3


def test_nano_is_smaller_and_what_is_given_wins():
    nano = preset("nano", "run.steps=7")
    assert nano.run.model.width < preset("small").run.model.width and nano.run.steps == 7


def test_without_a_preset_the_equilibrium_is_the_papers():
    loss = parse(PretrainCommand, [], PRESETS).run.loss
    assert (loss.equilibrium, loss.equilibrium_scale) == ("patch", "absolute")
