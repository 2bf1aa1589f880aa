from dataclasses import replace

import numpy as np
import pytest

from benchmarks.probes.labelled_set import LabelledSet, force_sequences
from benchmarks.probes.recorded_set import of_indenters, of_sensor, shear_agreement, to_labelled_set
from benchmarks.probes.zero_shot import POOL, encode_set, predict
from uniforce_datasets.readers import LabelledRecording, read_genforce
from uniforce_vtla.contact import UNSEEN
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.descriptor import describe
from uniforce_vtla.tokenizer.force_head import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.pair_cache import shrink

SIDE = 32


def test_windows_of_recordings_of_different_length(marker_trials):
    long, short, *_ = marker_trials
    short = replace(short, frames=short.frames[:3], force_N=short.force_N[:3])
    labelled = to_labelled_set([long, short], SIDE, 2)
    assert len(labelled.frames) == 4
    assert labelled.frames.dtype == labelled.reference.dtype == np.uint8
    for row, (source, start) in enumerate([(long, 0), (long, 2), (long, 4), (short, 0)]):
        window = slice(start, start + 2)
        frames = source.frames[window]
        assert np.array_equal(labelled.reference[row], shrink(source.reference[None], SIDE)[0])
        assert np.array_equal(labelled.frames[row], shrink(frames, SIDE))
        assert np.array_equal(labelled.descriptor[row], describe(source.reference, frames))
        assert np.array_equal(labelled.force_N[row], source.force_N[window])


def test_the_digest_names_the_content(marker_trials):
    def digest(side=SIDE, **changes):
        return to_labelled_set([replace(marker_trials[0], **changes)], side, 3).digest

    image = marker_trials[0].frames.copy()
    image[1, 100, 100] ^= 255
    other_force = marker_trials[0].force_N + np.float32(1e-6)
    assert digest(side=16) == digest()  # of full-size images, as simulated sets
    for changes in ({"frames": image}, {"force_N": other_force}, {"sensor": "g2"}):
        assert digest(**changes) != digest()


def test_sets_of_several_sensors_or_of_nothing_are_refused(marker_trials):
    one, _, other, *_ = marker_trials
    with pytest.raises(DatasetError, match="gelsight and tactip"):
        to_labelled_set([one, other], SIDE, 2)
    with pytest.raises(DatasetError, match="1 recordings are shorter"):
        to_labelled_set([one], SIDE)
    with pytest.raises(DatasetError, match="none; 0 recordings"):
        to_labelled_set([], SIDE)


def test_a_reference_without_markers_is_named(marker_trials):
    blank = replace(marker_trials[0], reference=np.zeros((480, 640), np.uint8))
    wanted = "gelsight/sphere/1: reference: expected at least 3 markers"
    with pytest.raises(DatasetError, match=wanted):
        to_labelled_set([blank], SIDE, 2)


def test_a_read_set_goes_through_tokenizer_and_head(genforce, tiny):
    assert {r.indenter for r in of_indenters(read_genforce(genforce), UNSEEN)} == {"wave"}
    tokenizer = Tokenizer.random(tiny)
    for sensor in ("gelsight", "tactip", "uskin"):
        read = to_labelled_set(of_sensor(read_genforce(genforce), sensor), tokenizer.config.side, 3)
        z = encode_set(tokenizer, read)
        assert z.shape == (4, 3, POOL**2, tiny.latent)
    head = train_head(z, read.force_N, HeadTrainingConfig(steps=2), seed=0)
    assert predict(head, z).shape == read.force_N.shape


def labelled(motion, shear):
    n = len(motion)
    descriptor = np.zeros((n, 1, 6), np.float32)
    descriptor[:, 0, :2] = motion
    force = np.zeros((n, 1, 3), np.float32)
    force[:, 0, :2] = shear
    return LabelledSet(np.zeros((n, 1, 1)), np.zeros((n, 1, 1, 1)), descriptor, force, "")


def test_shear_agreement_shows_the_signs():
    shear = np.random.default_rng(0).uniform(-2, 2, (60, 2))
    assert np.allclose(shear_agreement(labelled(5 * shear, shear)), [1, 1])
    assert np.allclose(shear_agreement(labelled(5 * shear, shear * (1, -1))), [1, -1])
    assert np.abs(shear_agreement(labelled(5 * shear[:, ::-1], shear))).max() < 0.4  # swapped
    assert np.isnan(shear_agreement(labelled(shear, 0 * shear))).all()


@pytest.mark.parametrize("sensor", ["gelsight", "uskin"])
def test_simulated_markers_agree_with_our_axes(sensor):
    """Flat pads drag their markers along the shear force they report; a dome's pins follow it
    less."""
    batch = force_sequences(np.random.default_rng(1), sensor, 10, 5, ("sphere",), units=2)
    recordings = [
        LabelledRecording(sensor, "sphere", "1", *parts)
        for parts in zip(batch.reference, batch.frames, batch.force_N, strict=True)
    ]
    assert (shear_agreement(to_labelled_set(recordings, SIDE, 5)) > 0.5).all()
