"""A range of latents: what lies in it, what doesn't, and a monitor that says so once it lasts."""

import pytest
import torch

from benchmarks.trust.injuries import edit_json
from uniforce_vtla.errors import CheckpointError, ContractError, SensorError
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS, HealthMonitor, LatentRange

LOOKS = 8
PATCHES, CHANNELS = 4, 3


def drawn(count, seed=0):
    """Return (n, P, L) latents whose numbers depend on one another."""
    size = PATCHES * CHANNELS
    mixing = torch.randn(size, size, generator=torch.Generator().manual_seed(1))
    rows = torch.randn(count, size, generator=torch.Generator().manual_seed(seed)) @ mixing + 5
    return rows.unflatten(1, (PATCHES, CHANNELS))


ODD = drawn(1, 3) + 2  # at 2.5 of the usual distance


@pytest.fixture
def usual():
    found = LatentRange.fit(drawn(4000), "tactip", "abc")
    found.free_limit, found.run_limit = 1.6, 1.4
    return found


def test_what_was_fitted_lies_one_away_whatever_its_scale(usual):
    mean_square = usual.distance(drawn(2000, 7)).square().mean().item()
    assert 0.7 < mean_square < 1.05  # the floor takes a little
    stretched = LatentRange.fit(100 * drawn(4000), "tactip", "abc").distance(100 * drawn(5, 3))
    assert torch.allclose(stretched, usual.distance(drawn(5, 3)), rtol=1e-2)


def test_too_few_latents_are_refused():
    with pytest.raises(ContractError, match="more than 12"):
        LatentRange.fit(drawn(12), "tactip", "abc")


def test_a_range_is_stored_and_read_back(usual, tmp_path):
    again = LatentRange.from_pretrained("tactip", usual.save(tmp_path / "range"))
    assert torch.allclose(again.distance(drawn(3)), usual.distance(drawn(3)))
    assert (again.kind, again.tokenizer_hash) == ("tactip", "abc")
    assert (again.free_limit, again.run_limit) == (1.6, 1.4)


def test_a_folder_without_limits_is_refused(usual, tmp_path):
    folder = usual.save(tmp_path / "range")
    edit_json(folder / "config.json", lambda config: config.pop("run_limit"))
    drop_hashes(folder)
    with pytest.raises(CheckpointError, match="run_limit"):
        LatentRange.from_pretrained("tactip", folder)


def test_one_odd_look_is_forgiven_and_half_a_second_of_them_is_not(usual):
    monitor = HealthMonitor(usual, "right", LOOKS)
    for look in drawn(300, 9):
        monitor.see(look[None])
    monitor.see(ODD)
    says = r"tactip on the right finger over half a second.*monitor=off"
    with pytest.raises(SensorError, match=says):
        for _ in range(LOOKS):
            monitor.see(ODD)


def test_an_odd_picture_in_free_air_is_noticed_at_the_third_look_of_each_episode(usual):
    monitor = HealthMonitor(usual, "left", LOOKS)
    for _ in range(2):
        monitor.reset()
        for _ in range(FREE_LOOKS - 1):
            monitor.see(ODD)
        with pytest.raises(SensorError, match="in free air"):
            monitor.see(ODD)


def test_with_a_new_reference_a_few_flickering_markers_pass_and_many_do_not(usual):
    monitor = HealthMonitor(usual, "left", LOOKS)
    for times, alarm in ((1.5, False), (3.0, True)):
        for renewed in (False, True):
            monitor.reset(renewed)
            free = [monitor.judge(times * usual.free_limit)[0] for _ in range(FREE_LOOKS)][-1]
            assert (free > 1) == (alarm or not renewed)


def test_of_several_environments_the_worst_counts(usual):
    monitor = HealthMonitor(usual, "left", LOOKS)
    looks = torch.cat([drawn(3, 5), ODD])
    with pytest.raises(SensorError):
        for _ in range(FREE_LOOKS):
            monitor.see(looks)


def test_training_samples_are_not_watched(usual):
    monitor = HealthMonitor(usual, "left", LOOKS)
    monitor.active = False
    for _ in range(2 * LOOKS):
        monitor.see(ODD)
