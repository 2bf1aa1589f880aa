"""Label-free calibration: equal forces give equal latents afterwards, and what can't be calibrated
is refused."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
import torch

from uniforce_vtla.contact import TactileSimulator
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.calibrate import calibrate
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.calibration_choice import choose_form
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.gains import gain_of_loads, gain_through_a_tool
from uniforce_vtla.tokenizer.latent import Latent
from uniforce_vtla.tokenizer.latent_map import fit_map
from uniforce_vtla.tokenizer.settings import CalibrationConfig

CLASSES = ("small", "tool") * 150


def numbers(*shape, seed):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


WHOLE = torch.eye(96) + 0.3 * numbers(96, 96, seed=1) / 96**0.5


def latent(z):
    return Latent.of(z, "abc")


def grasps(n=300):
    """A new sensor whose whole map differs from the anchor's: regions mixed, weaker, shifted."""
    torch.manual_seed(0)
    anchor = torch.randn(n, 6) @ torch.randn(6, 96)
    new = 0.7 * anchor @ WHOLE + 0.2 + 0.01 * torch.randn(n, 96)
    return latent(new.view(n, 16, 6)), latent(anchor.view(n, 16, 6))


@pytest.fixture
def calibrated():
    """Return a function: paired grasps, those of the usual classes → a calibration."""
    torch.manual_seed(0)
    usual = ForceHead(ForceRegressor(HeadConfig()), "tactip", "abc")

    def run(new, anchor, classes=CLASSES, *more, head=usual, **grasps):
        return calibrate(new, anchor, classes, head, "new", "old", *more, **grasps)

    return run


def reader(read):
    """Stand for a head: what it reads in latents (n, 16, 6)."""
    return mock.Mock(
        side_effect=lambda z: read(z.as_subclass(torch.Tensor)), tokenizer_hash="abc", hash="def"
    )


# .8 of the load that the first number of a latent holds
SCALE = reader(lambda z: torch.cat([z[:, 0, :2], 0.8 * z[:, 0, :1]], dim=1))
# a latent's first three numbers are the force
PLAIN = reader(lambda z: z[:, 0, :3])
# 1.25 of the shear along y that the first number of a latent holds, and a grip
SHEAR = reader(lambda z: z[:, 0, :1] * torch.tensor([0.0, 1.25, 0.0]) + torch.tensor([0, 0, 9.0]))


FREE = torch.zeros(16, 6)


def presses(*load_N):
    z = torch.zeros(len(load_N), 16, 6)
    z[:, 0, 0] = torch.tensor(load_N)
    return latent(z)


def weighed():
    return gain_of_loads(presses(3, 6, 9), (3, 6, 9), SCALE, "tactip:7", FREE)


def is_stored_whole(found, folder):
    again = Calibration.load(found.save(folder), "abc")
    return replace(again, map=found.map) == found and again.hash == found.hash


def test_grasps_it_never_saw_balance_afterwards(calibrated):
    new, anchor = grasps()
    found = calibrated(new[:200], anchor[:200], CLASSES[:200])
    before, after = ((z[200:] - anchor[200:]).square().mean() for z in (new, found(new)))
    assert before > 0.05 and after < 0.02 * before
    for judged in found.agreement.values():
        assert min(judged.r2) > 0.95 and judged.grasps == 20
        assert max(judged.r2_before) < min(judged.r2)
    assert found.worst()[1] == min(judged.r2[2] for judged in found.agreement.values())


def test_equal_sensors_stay_as_they_are(calibrated):
    _, anchor = grasps()
    found = calibrated(anchor, anchor)
    assert torch.equal(found(anchor), anchor)
    assert found.choice.form == "none" and found.agreement["small"].r2 == (1.0, 1.0, 1.0)


def test_the_ridge_grows_with_what_can_not_be_explained():
    new, anchor = grasps()
    noisy = new + 3 * torch.randn(new.shape)
    exact, loose = (fit_map(z[:60], anchor[:60])[1] for z in (new, noisy))
    assert loose > 10 * exact


def test_one_class_of_objects_does_not_speak_for_the_other(calibrated):
    """Tools whose latents answer the other way round: each class is judged on its own grasps."""
    new, anchor = grasps()
    new[1::2] = torch.randn(150, 16, 6)
    found = calibrated(new, anchor)
    assert found.worst()[0] == "tool"
    assert found.agreement["tool"].r2[2] < found.agreement["small"].r2[2] - 0.1


def test_saved_equals_loaded_and_another_tokenizer_is_refused(tmp_path, calibrated):
    new, anchor = grasps()
    found = calibrated(new, anchor)
    assert is_stored_whole(found, tmp_path) and found.choice.form == "map"
    again = Calibration.load(tmp_path, "abc")
    assert torch.equal(again(new), found(new)) and again(new).tokenizer_hash == "abc"
    with pytest.raises(CheckpointError, match="Calibrate again"):
        Calibration.load(tmp_path, "xyz")
    with pytest.raises(CheckpointError, match="calibration of new"):
        again(Latent.of(anchor, "xyz"))
    with pytest.raises(CheckpointError, match="latents for calibration"):
        calibrated(Latent.of(new, "xyz"), anchor)


@pytest.mark.parametrize("shape", [(4, 64, 6), (16, 6), (0, 16, 6)])
def test_only_pooled_latents_are_mapped(shape):
    with pytest.raises(ContractError, match="pool_latent"):
        weighed()(latent(torch.zeros(shape)))


DRAWN = torch.rand(90, 16, 6)
OTHER = torch.rand(90, 16, 6)


@pytest.mark.parametrize(
    "new, anchor, classes, says",
    [
        (DRAWN, OTHER, ("small",) * 90, "tool objects are missing"),
        (DRAWN, OTHER, ("small", "hammer") * 45, "class of an object"),
        (DRAWN, OTHER[:, :9], CLASSES[:90], "twice"),
        (DRAWN, OTHER, CLASSES[:80], "80 classes"),
        (DRAWN, OTHER, ("small",) * 80 + ("tool",) * 10, "tool objects"),
        (torch.nan * DRAWN, OTHER, CLASSES[:90], "finite"),
        (DRAWN, 0 * OTHER, CLASSES[:90], "changing"),
    ],
)
def test_bad_grasps_are_refused(new, anchor, classes, says, calibrated):
    with pytest.raises(ContractError, match=says):
        calibrated(latent(new), latent(anchor), classes)


def test_frames_of_few_grasps_are_refused(calibrated):
    few = "separate grasps of small objects: expected at least 3, got 2"
    with pytest.raises(ContractError, match=few):
        calibrated(*grasps(), grasps=[row % 4 for row in range(300)])


def test_a_whole_grasp_judges_or_chooses(calibrated):
    """Sixty grasps of five rows, a class each in turn: a fifth of them judges."""
    classes = tuple(np.repeat(CLASSES[:60], 5))
    found = calibrated(*grasps(), classes, grasps=[row // 5 for row in range(300)])
    assert found.choice.grasps == 48
    assert [judged.grasps for judged in found.agreement.values()] == [6, 6]


def test_who_judges_is_drawn_by_the_seed_alone(calibrated):
    one, two, three = (
        calibrated(*grasps(), CLASSES, CalibrationConfig(seed=seed)) for seed in (0, 0, 1)
    )
    assert one.agreement == two.agreement != three.agreement
    assert np.isfinite([*one.agreement["tool"].abs_r]).all()


def test_a_sensor_that_is_turned_is_refused_and_shear_that_says_nothing_is_warned_of(
    caplog, calibrated
):
    _, anchor = grasps()
    turned = anchor.as_subclass(torch.Tensor).clone()
    turned[:, 0, :2] *= -1
    says = r"both upright, got the one turned .*rotation_deg=180 in the rig"
    with pytest.raises(ContractError, match=says):
        calibrated(latent(turned), anchor, head=PLAIN)
    assert not caplog.text
    turned[:, 0, 1] = torch.randn(len(turned))
    calibrated(latent(turned), anchor, head=PLAIN)
    assert "too little to tell how it is mounted" in caplog.text


def pushed(seed, grasps=200, rows=1):
    """Latents (n, 16, 6) of grasps whose rows are alike."""
    drawn = numbers(grasps, 16, 6, seed=seed).repeat_interleave(rows, dim=0)
    return drawn + 0.01 * numbers(*drawn.shape, seed=seed + 1)


def test_noise_is_not_calibrated():
    """Both fingers are read with the same noise: a map that shrinks the reading would lower the
    error, and misread."""
    force = pushed(0)
    choice = choose_form(force + 0.3 * pushed(3), force + 0.3 * pushed(7), SCALE)
    assert choice.form == "none" and min(choice.error.values()) > 0.01


def test_frames_of_a_grasp_do_not_choose_for_each_other():
    """Fingers that have nothing in common: a map can only learn each grasp by heart, from its other
    frames."""
    new, anchor = pushed(0, grasps=30, rows=10), pushed(2, grasps=30, rows=10)
    by_row = choose_form(new, anchor, SCALE)
    by_grasp = choose_form(new, anchor, SCALE, [row // 10 for row in range(300)])
    assert by_row.form == "map" and by_row.error["map"] < 0.2
    assert by_grasp.error["map"] > 0.9 and by_grasp.grasps == 30


def test_axes_that_differ_between_the_fingers_can_be_left_out():
    """Opposite shear and equal normal force, as of an object that is only squeezed."""
    anchor = pushed(0)
    z = torch.zeros_like(anchor)
    z[:, 0, :2] = anchor[:, 0, :2]
    opposite = z.clone()
    opposite[:, 0, 1] *= -1
    assert choose_form(opposite, z, SCALE, axes=(2,)).form == "none"
    assert choose_form(opposite, z, SCALE).form == "map"


def test_one_grasp_chooses_nothing():
    with pytest.raises(ContractError, match="2 or more"):
        choose_form(pushed(0), pushed(0), SCALE, [0] * 200)


def test_known_loads_give_a_gain_of_latents_that_is_stored(tmp_path):
    found = weighed()
    assert SCALE(found(presses(3)))[0, 2] == pytest.approx(3, abs=0.02)
    assert found.latent_gain == pytest.approx(1.25, abs=0.01)
    assert (found.new, found.head_hash) == ("tactip:7", "def")
    # no choice, as in calibrations older than it
    assert is_stored_whole(found, tmp_path) and "choice" not in found.facts()
    plain = gain_of_loads(presses(3.75, 7.5, 11.25), (3, 6, 9), SCALE, "tactip:7", FREE)
    assert plain.latent_gain == pytest.approx(1.0, abs=0.01) and plain.hash != found.hash


def test_a_gain_of_newtons_of_an_older_version_is_refused(tmp_path):
    found = weighed()
    with mock.patch.object(Calibration, "facts", return_value=found.facts() | {"gain": 1.3}):
        found.save(tmp_path)
    with pytest.raises(CheckpointError, match="a gain of newtons, of version"):
        Calibration.load(tmp_path, "abc")


@pytest.mark.parametrize(
    "load_N", [(3, 6), (0, 3, 6), (3, 6, np.nan), (300, 600, 900), (9, 6, 3), (3, 6, 9, 9)]
)
def test_loads_that_give_no_gain_are_refused(load_N):
    with pytest.raises(ContractError, match=r"loads|presses"):
        gain_of_loads(presses(3, 6, 9)[: len(load_N)], load_N, SCALE, "tactip:7", FREE)


WEIGHT_N = 0.6


def through_tool(*load_N):
    """Latents of a finger that holds a tool on a scale: half of the weight that is left hangs on
    it."""
    return presses(*[(WEIGHT_N - load) / 2 for load in load_N])


def test_a_tool_on_a_scale_gives_a_gain_of_latents(tmp_path):
    loads = (0.0, 3.0, 6.0, 9.0)
    z = through_tool(*loads)
    free = torch.full(z.shape[1:], 0.3)
    found = gain_through_a_tool(z, loads, SHEAR, "uskin:7", free)
    assert torch.allclose(found.map(free[None]), free[None])
    read_N = SHEAR(found(z))[:, 1]
    assert (read_N[0] - read_N).tolist() == pytest.approx([0, 1.5, 3, 4.5], abs=0.02)
    assert found.latent_gain == pytest.approx(0.8, abs=0.01)
    assert is_stored_whole(found, tmp_path)
    with pytest.raises(ContractError, match="a gain of latents"):
        gain_through_a_tool(z, [10 * load for load in loads], SHEAR, "uskin:7", free)


@pytest.mark.parametrize(
    "load_N", [(3, 6, 9, 9), (0, 3, 6, 6), (0, 3, 6, np.nan), (0, 9, 6, 3), (0, -3, 6, 9), (0, 3)]
)
def test_tools_that_give_no_gain_are_refused(load_N):
    with pytest.raises(ContractError, match=r"loads|presses"):
        gain_through_a_tool(through_tool(0, 3, 6, 9), load_N, SHEAR, "uskin:7", FREE)


@pytest.mark.parametrize("kind", ["tactip", "gelsight", "uskin"])
def test_free_air_has_about_the_latent_of_an_unmoved_marker(kind):
    tokenizer = Tokenizer.from_pretrained()
    free = TactileSimulator(kind).reference()[None]
    assert (tokenizer.pooled(free, free, "right")[0] - tokenizer.unmoved()).abs().max() < 0.03
