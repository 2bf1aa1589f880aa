import numpy as np
import pytest
from episode_samples import N, good_trace

from benchmarks.descriptor_heads import EpisodeForces, described_episodes, errors, judge, worn
from benchmarks.trust.injuries import edit_json
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.tokenizer.descriptor import DESCRIPTOR_NAMES, NATURAL_UNITS, describe
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead


def grid(scale=1.0, shift=(0, 0), size=8, turn=0.0):
    image = np.zeros((200, 240), np.uint8)
    for y in range(-60, 61, 40):
        for x in range(-80, 81, 40):
            column = round(120 + scale * (x - turn * y)) + shift[0] - size // 2
            row = round(100 + scale * (y + turn * x)) + shift[1] - size // 2
            image[row : row + size, column : column + size] = 255
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


def test_a_saved_head_reads_the_same(heads, tmp_path):
    heads["tactip"].save(tmp_path)
    described, _ = made_up(100).fingers["right"]
    again = DescriptorHead.from_pretrained("tactip", tmp_path)
    np.testing.assert_array_equal(again.read(described), heads["tactip"].read(described))
    with pytest.raises(CheckpointError):
        DescriptorHead.from_pretrained("uskin", tmp_path)


def test_a_head_of_another_descriptor_is_refused(heads, tmp_path):
    folder = heads["tactip"].save(tmp_path)
    drop_hashes(folder)
    edit_json(folder / "config.json", lambda facts: facts.update(descriptor=["dx"]))
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


def made_up(seed):
    """Descriptors that are the force itself in natural units, with a little noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) / 30
    press = np.interp(t, [2.0, 2.5], [0.0, rng.uniform(4, 9)])
    up = (1.0 - press) / 2 * (t > 1)
    grip = np.where(t > 0.5, rng.uniform(8, 12), 0.0)
    force = np.column_stack([0.3 * np.sin(3 * t), up, grip]).astype(np.float32)
    true = np.tile(force, 2)
    fingers = {}
    for finger in FINGERS:
        noisy = (true + 0.01 * rng.standard_normal(true.shape)) * NATURAL_UNITS
        fingers[finger] = noisy.astype(np.float32), force
    sensors = {"left": "gelsight", "right": "tactip"}
    place = np.column_stack([0 * t, 0 * t, np.interp(t, [0.8, 1.5], [0.1, 0.2])])
    trace = good_trace(time_s=t, press_N=press, phase=np.digitize(t, [1.2, 2.0]))
    return EpisodeForces(fingers, sensors, place, (0.9, 0.9), trace)


@pytest.fixture(scope="module")
def heads():
    lessons = worn([made_up(seed) for seed in range(8)])
    return {s: DescriptorHead.fit(s, wipes, stretch=15, steps=100) for s, wipes in lessons.items()}


def test_heads_read_what_the_descriptors_hold_and_judge_by_it(heads):
    assert set(heads) == {"gelsight", "tactip"}
    cell = errors(heads["tactip"], worn([made_up(100), made_up(101)])["tactip"])
    assert min(cell["r2"]) > 0.8
    row = judge(heads, made_up(102))
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
