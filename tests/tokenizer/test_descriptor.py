import json

import numpy as np
import pytest

from benchmarks.descriptor_heads import EpisodeForces, described_episodes, errors, judge, worn
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.evaluation.episode import EpisodeTrace
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.tokenizer.descriptor import DESCRIPTOR_NAMES, NATURAL_UNITS, describe
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead


def grid(scale=1.0, shift=(0, 0), size=8, turn=0.0):
    image = np.zeros((200, 240), np.uint8)
    for y in range(-60, 61, 40):
        for x in range(-80, 81, 40):
            column = round(120 + scale * (x - turn * y)) + shift[0]
            row = round(100 + scale * (y + turn * x)) + shift[1]
            image[row - size // 2 : row + size // 2, column - size // 2 : column + size // 2] = 255
    return image


def named(reference, current):
    return dict(zip(DESCRIPTOR_NAMES, describe(reference, current[None])[0].tolist(), strict=True))


def test_known_shift():
    found = named(grid(), grid(shift=(5, -3)))
    assert found["dx"] == pytest.approx(5) and found["dy"] == pytest.approx(-3)
    assert abs(found["divergence"]) < 1e-6 and abs(found["curl"]) < 1e-6
    assert found["area_change"] == 0 and found["count"] == 1


def test_known_dilation_growth_and_turn():
    assert named(grid(), grid(scale=1.1))["divergence"] == pytest.approx(0.2, abs=0.01)
    assert named(grid(), grid(size=12))["area_change"] == pytest.approx(np.log(12**2 / 8**2))
    assert named(grid(), grid(turn=0.05))["curl"] == pytest.approx(0.1, abs=0.01)


def test_lost_markers_are_counted_and_none_is_no_crash():
    half = grid()
    half[:100] = 0
    assert named(grid(), half)["count"] == pytest.approx(0.5)
    assert named(grid(), np.zeros_like(half)) == dict.fromkeys(DESCRIPTOR_NAMES, 0.0)


def test_bad_references_raise():
    with pytest.raises(ContractError):
        describe(np.zeros((200, 240), np.uint8), grid()[None])
    with pytest.raises(ContractError):
        describe(grid() // 2, grid()[None])


def wipe(seed, frames=60):
    force = np.random.default_rng(seed).uniform(-4, 4, (frames, 3)).astype(np.float32)
    return (np.concatenate([force, force], axis=1) * NATURAL_UNITS).astype(np.float32), force


def test_a_saved_head_reads_the_same(tmp_path):
    head = DescriptorHead.fit("tactip", [wipe(seed) for seed in range(8)], stretch=20, steps=150)
    seen, force = wipe(100)
    read = head.read(seen)
    assert np.abs(read - force).mean() < 0.5 * np.abs(force).mean()
    head.save(tmp_path)
    np.testing.assert_array_equal(
        DescriptorHead.from_pretrained("tactip", tmp_path).read(seen), read
    )
    with pytest.raises(CheckpointError):
        DescriptorHead.from_pretrained("uskin", tmp_path)


def test_a_head_of_another_descriptor_is_refused(tmp_path):
    folder = DescriptorHead.fit("tactip", [wipe(0)], stretch=20, steps=1).save(tmp_path)
    drop_hashes(folder)
    facts = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(facts | {"descriptor": ["dx"]}))
    with pytest.raises(CheckpointError, match="Make it again"):
        DescriptorHead.from_pretrained("tactip", tmp_path)


@pytest.mark.parametrize("sensor", ["gelsight", "tactip", "uskin"])
def test_every_sensor_of_the_scene_has_a_shipped_head_that_refuses_nonsense(sensor):
    head = DescriptorHead.from_pretrained(sensor)
    assert head.read(np.zeros((5, 6))).shape == (5, 3)
    with pytest.raises(ContractError, match="descriptors"):
        head.read(np.zeros((5, 4)))
    with pytest.raises(ContractError, match="finite"):
        head.read(np.full((5, 6), np.nan))


FRAMES = 120


def made_up(seed):
    """Descriptors that are the force itself in natural units, with a little noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(FRAMES) / 30
    press = np.interp(t, [2.0, 2.5], [0.0, rng.uniform(4, 9)])
    up = (1.0 - press) / 2 * (t > 1)
    grip = np.where(t > 0.5, rng.uniform(8, 12), 0.0)
    force = np.stack([0.3 * np.sin(3 * t), up, grip], axis=1).astype(np.float32)
    flat = np.zeros(FRAMES)
    phase = np.digitize(t, [1.2, 2.0])
    trace = EpisodeTrace(t, press, grip, grip, *[flat] * 6, phase, rated_depth_mm=(1.5, 5.0))
    true = np.concatenate([force, force], axis=1) * NATURAL_UNITS
    fingers = {}
    for finger in FINGERS:
        noise = 0.01 * rng.standard_normal(true.shape) * NATURAL_UNITS
        fingers[finger] = (true + noise).astype(np.float32), force
    sensors = {"left": "gelsight", "right": "tactip"}
    place = np.stack([flat, flat, np.interp(t, [0.8, 1.5], [0.1, 0.2])], axis=1)
    return EpisodeForces(fingers, sensors, place, (0.9, 0.9), trace)


def heads():
    lessons = worn([made_up(seed) for seed in range(8)])
    return {s: DescriptorHead.fit(s, wipes, stretch=30, steps=300) for s, wipes in lessons.items()}


def test_heads_read_what_the_descriptors_hold_and_judge_by_it():
    found = heads()
    assert set(found) == {"gelsight", "tactip"}
    cell = errors(found["tactip"], worn([made_up(100), made_up(101)])["tactip"])
    assert min(cell["r2"]) > 0.8
    row = judge(found, made_up(102))
    assert row["press_mae_N"] < 1.0
    assert row["press_above_limit"] == [False, False]


@pytest.mark.thorough
def test_a_described_episode_is_a_whole_wipe_of_both_fingers():
    """One short look: the scene's own frames described, forces beside them."""
    (episode,) = described_episodes("touch", range(70_500, 70_501))
    n = len(episode.trace.time_s)
    assert episode.sensors == {"left": "gelsight", "right": "tactip"}
    for finger in FINGERS:
        described, force = episode.fingers[finger]
        described = described / NATURAL_UNITS
        assert described.shape == (n, 6) and force.shape == (n, 3)
        moved = np.abs(described - described[force[:, 2] < 0.02].mean(axis=0)).mean(axis=1)
        assert moved[force[:, 2] > 3.0].mean() > 3 * moved[force[:, 2] < 0.02].mean()
