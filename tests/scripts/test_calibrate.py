"""Calibration as a person starts it: which sensors it takes, what it says, what it refuses."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from contact_samples import StillFinger, faces

from uniforce_cli.calibrate import main
from uniforce_cli.known_loads import presses_by_hand
from uniforce_cli.paired_grasps import recorded_grasps
from uniforce_datasets.readers.recording import PairRecording
from uniforce_datasets.readers.uniforce_pairs import write_uniforce_pairs
from uniforce_robots.sensors.config_uniforce import Orientation
from uniforce_vtla.contact import TactileSimulator
from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.sampling import ForceRange, sample_loads, sample_objects
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers.mirror import mirrored
from uniforce_vtla.tokenizer import ForceHead, Latent, Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.gains import gain_of_loads, gain_through_a_tool
from uniforce_vtla.tokenizer.mount_relation import SETTINGS


@pytest.fixture
def calibrated(tmp_path):
    """Return a function: calibrate by some words → what was stored."""

    def calibrate(*words):
        assert main([*words, f"out={tmp_path / 'found'}"]) == 0
        return Calibration.load(tmp_path / "found", Tokenizer.from_pretrained().hash)

    return calibrate


def test_a_unit_learns_to_read_as_another_one_does(calibrated, capsys):
    """Unit 12 of a TacTip is stiffer and answers to the same grasp by .84 of unit 1."""
    found = calibrated("new=tactip:12", "anchor=tactip:1", "grasps=120")
    printed = capsys.readouterr().out
    assert "tactip:12 against tactip:1" in printed and "chosen by" in printed
    assert (found.new, found.anchor) == ("tactip:12", "tactip:1")
    for judged in found.agreement.values():
        assert judged.r2[2] > 0.95 and judged.r2[2] > judged.r2_before[2]


def test_a_grasp_that_the_canonicaliser_refuses_is_left_out(calibrated, caplog):
    """A pad of four tenths its stiffness moves markers further than any that pretraining saw, in
    the firmest grasps."""
    calibrated("new=tactip:1+stiffness=0.4", "anchor=tactip:1", "grasps=120")
    assert "of 120 grasps are left out" in caplog.text


@pytest.mark.parametrize("words", ["tactip:any", "tactip:left", "nose:3"])
def test_only_a_sensor_that_stays_the_same_is_calibrated(words, refuses):
    refuses(main, [f"new={words}"], words.partition(":")[0])


@pytest.mark.parametrize(
    "sensors, new_is",
    [
        (("tactip", "gelsight"), "left"),
        (("gelsight", "tactip"), "right"),
        (("tactip_l", "tactip_r"), "left"),
    ],
)
def test_recorded_pairs_of_two_units_of_a_kind_are_kept_apart(sensors, new_is, tmp_path):
    images = np.zeros((3, 480, 640), np.uint8)
    images[:, 200:280, 280:360] = 255
    recording = PairRecording(sensors, "tool", "", images[0], images[0], images, images)
    # folders named as `uniforce pairs` names them
    write_uniforce_pairs(tmp_path, recording, "marker")
    value = {"left": 1.0, "right": 2.0}
    tokenizer = SimpleNamespace(
        pooled=lambda ref, now, finger: Latent.of(torch.full((3, 16, 6), value[finger]), "abc")
    )
    anchor = "gelsight" if "gelsight" in sensors else "tactip:1"
    grasps = recorded_grasps(str(tmp_path), "tactip:7", anchor, "tool,flat", tokenizer)
    assert grasps.classes == ("tool",) * 3 and len(grasps.new) == 3 and grasps.numbers == (0, 0, 0)
    assert float(grasps.new.mean()) == value[new_is] != float(grasps.anchor.mean())


def record_pairs(root, new, anchor, mount):
    """Write 60 grasps, half small objects, half tools, with the new sensor left, as its mount shows
    them."""
    as_mounted = Orientation(*SETTINGS[mount]).of_frame  # each of these settings undoes itself
    rng = np.random.default_rng(0)
    for indenter, flat_share in {"small": 0.0, "tool": 1.0}.items():
        objects = sample_objects(rng, 30, PRETRAIN, flat_share=flat_share)
        force, torsion = sample_loads(rng, 30, ForceRange(), objects.names)
        contact = ContactState(objects.gap_mm, force, torsion)
        left, right = (WornView(wear(words)(0), seed) for seed, words in enumerate((new, anchor)))
        shown = np.stack([as_mounted(image) for image in left.images(contact)])
        sensors = new.partition(":")[0], anchor.partition(":")[0]
        references = as_mounted(left.reference), right.reference
        recording = PairRecording(
            sensors, indenter, "", *references, shown, right.images(mirrored(contact))
        )
        write_uniforce_pairs(root, recording, "marker")
    return root


@pytest.mark.parametrize(
    "new, mount", [("uskin:2", "upright"), ("uskin:2", "mirrored_y"), ("gelsight:2", "turned")]
)
def test_a_sensor_mounted_the_wrong_way_is_refused_until_it_is_said(
    new, mount, tmp_path, capsys, monkeypatch
):
    # here each frame is a grasp of its own
    monkeypatch.setattr("uniforce_cli.paired_grasps.STRETCH", 1)
    pairs = record_pairs(tmp_path / "pairs", new, "tactip:1", mount)
    asked = [f"new={new}", "anchor=tactip:1", f"pairs={pairs}", f"out={tmp_path / 'map'}"]
    if mount != "upright":
        assert main(asked) == 2
        said = capsys.readouterr().err
        assert f"the one {mount} against the other" in said and f"mounted={mount}" in said
        assert "rotation_deg=180" in said and ("flip=true" in said) == (mount == "mirrored_y")
        assert not (tmp_path / "map").exists()
    assert main([*asked, f"mounted={mount}"]) == 0
    assert (tmp_path / "map").exists()


def test_a_mount_is_stated_of_recorded_pairs_alone(refuses):
    refuses(main, ["new=uskin:2", "mounted=turned"], "recorded pairs")


@pytest.mark.parametrize(
    "words, named",
    [("through=tool", "through"), ("loads_N=3,6,9 task=tool", "task"), ("tools=bar", "tools")],
)
def test_settings_that_change_nothing_are_refused(words, named, refuses):
    refuses(main, words.split(), f"got {named}")


def test_grasps_that_are_all_refused_are_an_error_in_words(refuses):
    refuses(main, ["new=gelsight:1+lost=0.9", "grasps=8"], "got none of 8")


def test_simulated_loads_undo_a_pad_that_answers_less(calibrated, capsys):
    found = calibrated("new=tactip:1+gain=0.7", "loads_N=3,6,9")
    assert "tactip:1+gain=0.7: gain of latents 1." in capsys.readouterr().out
    assert found.latent_gain == pytest.approx((1 / 0.7) ** 0.5, abs=0.12)


@pytest.mark.parametrize(
    "arguments, reason",
    [
        (["loads_N=3,3,3"], "3 or more different"),
        (["loads_N=3,6,-9"], "0.5 to 50.0 N each"),
        (["loads_N=300,600,900"], "100 g on a scale are 1 N"),
        (["loads_N=3,6,9", "pairs={folder}"], "pairs= and loads_N="),
        (["loads_N=3,6,9", "rig={folder}/rig.yaml", "finger=left"], "left finger"),
        (["loads_N=3,6,9", "rig={folder}/rig.yaml"], "new, as"),
    ],
)
def test_loads_that_can_not_be_pressed_are_refused(arguments, reason, tmp_path, refuses):
    camera = "{type: uniforce_tactile, finger: right, sensor: tactip, source: /dev/x}"
    (tmp_path / "rig.yaml").write_text(f"robot:\n  cameras:\n    tactile_right: {camera}\n")
    given = [word.format(folder=tmp_path) for word in arguments]
    sensor = "uskin" if reason.startswith("new") else "tactip"
    refuses(main, [f"new={sensor}", *given, f"out={tmp_path / 'gain'}"], reason)
    assert not (tmp_path / "gain").exists()


class Pressed(StillFinger):
    """A TacTip on the right finger that is pressed with what was asked for."""

    config = SimpleNamespace(finger="right")

    def __init__(self, grip_N=0.0):
        self.simulator, self.load_N = TactileSimulator("tactip", seed=1), 0.0
        self.grip_N = grip_N  # of the tool that it holds; 0: it is pressed bare
        super().__init__("tactip", self.simulator.raw_reference())

    def ask(self, said):
        self.load_N = 0.0
        if "hang free" not in said:
            self.load_N = float(said.partition("(")[2].partition(" N")[0])

    def next_touch(self, index):
        force = [0, -self.load_N / 2, self.grip_N] if self.grip_N else [0, 0, self.load_N]
        (raw,) = self.simulator.raw_frames(faces([force], side_mm=20.0))
        return SimpleNamespace(index=index + 1, raw=raw)


def test_a_person_presses_each_load_and_frames_of_it_are_read():
    finger, tokenizer = Pressed(), Tokenizer.from_pretrained()
    z, load_N = presses_by_hand(finger, (3, 6, 9), tokenizer.pooled, ask=finger.ask)
    assert load_N.tolist() == [3] * 10 + [6] * 10 + [9] * 10 and len(z) == 30
    found = gain_of_loads(z, load_N, ForceHead.from_pretrained(), "tactip", tokenizer.unmoved())
    assert 0.8 < found.latent_gain < 1.25
    with pytest.raises(ContractError, match="a terminal"):
        presses_by_hand(finger, (3, 6, 9), tokenizer.pooled)


def test_a_person_lets_the_tool_hang_and_presses_it(capsys):
    finger, tokenizer = Pressed(grip_N=10.0), Tokenizer.from_pretrained()
    asked = (finger, (3, 6, 9), tokenizer.pooled, True)
    z, load_N = presses_by_hand(*asked, ask=finger.ask)
    assert {*load_N.tolist()} == {0, 3, 6, 9} and "grasp the tool" in capsys.readouterr().out
    head = ForceHead.from_pretrained()
    found = gain_through_a_tool(z, load_N, head, "tactip", tokenizer.unmoved())
    assert 0.8 < found.latent_gain < 1.25


@pytest.mark.parametrize("worn", ["tactip:2", "uskin:2", "gelsight:2"])
def test_every_kind_is_weighed_through_the_tool(worn, calibrated):
    """A covered flat gel can't be weighed bare; the shear of what it holds it shows."""
    found = calibrated(f"new={worn}", "loads_N=3,6,9", "through=tool")
    assert 0.6 < found.latent_gain < 1.4
