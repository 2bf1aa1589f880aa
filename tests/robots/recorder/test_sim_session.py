"""The same session in the simulated scene: steered by hand or by script, judged by the scene's truth."""

from pathlib import Path

import numpy as np
from recording_fakes import sway

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.source import read_source
from uniforce_robots.recorder.assemble import run_session
from uniforce_robots.recorder.operators import Unattended
from uniforce_robots.recorder.session import SessionSettings
from uniforce_robots.recorder.sim_rig import SimRig
from uniforce_robots.recorder.store import StoreSettings, open_recorder
from uniforce_vtla import keys

STEPS = 6


def test_a_scene_is_recorded_like_a_robot(tmp_path: Path) -> None:
    rig, root = SimRig(WipeEnv("easy", max_steps=STEPS), paced=False), tmp_path / "data"
    store = StoreSettings(root, "local/test", reserve_MB=1.0)
    settings = SessionSettings(episodes=2, episode_s=10.0)
    parts = rig, sway(tmp_path), Unattended("success"), store, settings
    end = run_session(*parts, 5, open_store=open_recorder)
    assert end.exit_code == 0 and [e.label for e in end.endings] == ["failed_grasp"] * 2, "the scene judges"
    wanted = (keys.STATE, keys.ACTION, keys.OUTCOME, keys.SUCCESS, keys.SEED, keys.truth_wrench_key("left"))
    columns = read_source(root).columns(wanted)
    assert columns[keys.SEED].tolist() == [5] * STEPS + [6] * STEPS and not columns[keys.SUCCESS].any()
    assert {keys.OUTCOME_NAMES[i] for i in columns[keys.OUTCOME]} == {"failed_grasp"}
    assert np.abs(columns[keys.ACTION][:, 0] - columns[keys.STATE][:, 0]).max() > 1e-4
    dataset = open_dataset(root, return_uint8=True)
    env = WipeEnv("easy", max_steps=STEPS)
    observation, _ = env.reset(seed=6)
    first = dataset[STEPS]
    assert first["task"] == env.task
    image = first[keys.tactile_key("left")].permute(1, 2, 0).numpy()
    assert np.array_equal(image, observation["pixels"]["tactile_left"])
