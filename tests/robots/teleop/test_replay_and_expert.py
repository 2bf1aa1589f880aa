"""Files of actions, and the scripted expert in its scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

import uniforce_robots.teleop as ours
from uniforce_robots.teleop.replay import read_actions
from uniforce_vtla.errors import TeleoperatorError
from uniforce_vtla.keys import AXES

ROWS = np.array([0.5, 0, 0.2, 0, 0.05]) + np.arange(8)[:, None] * np.array([0.001, 0, -0.001, 0.01, 0])
EPISODES = np.repeat([3, 4], 4)


def write(folder: Path, suffix: str) -> Path:
    path = folder / f"actions{suffix}"
    if suffix == ".npz":
        np.savez(path, action=ROWS, episode_index=EPISODES)
    elif suffix == ".csv":
        pd.DataFrame(ROWS, columns=list(AXES)).assign(episode_index=EPISODES).to_csv(path, index=False)
    else:
        pd.DataFrame({"action": list(ROWS), "episode_index": EPISODES}).to_parquet(path)
    return path


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".parquet"])
def test_every_form_gives_its_episode_back(tmp_path: Path, suffix: str) -> None:
    assert np.allclose(read_actions(write(tmp_path, suffix), 4), ROWS[4:])


def test_a_recorded_dataset_replays(tmp_path: Path, connected: Callable[[str], Any]) -> None:
    config = ours.UniforceReplayConfig(
        path=str(write(tmp_path, ".parquet")), episode=3, calibration_dir=tmp_path
    )
    replay = ours.UniforceReplay(config)
    replay.connect()
    for _ in range(2):  # a start begins the file anew
        replay.start_from(ROWS[0])
        got = [list(replay.get_action().values()) for _ in range(4)]
        assert np.allclose(got, ROWS[:4])
        with pytest.raises(TeleoperatorError) as error:
            replay.get_action()
        assert error.value.fault == "ended"


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("none.npz", None, "connection"),
        ("form.txt", b"0", "connection"),
        ("broken.npz", b"PK\x03\x04 no zip", "garbage"),
        ("broken.parquet", b"PAR1 no parquet PAR1", "garbage"),
        ("other.csv", b"a,b\n1,2\n", "garbage"),
        ("nan.csv", (",".join(AXES) + "\n1,2,nan,4,5\n").encode(), "garbage"),
        ("empty.csv", (",".join(AXES) + "\n").encode(), "garbage"),
        ("nothing.csv", b"", "garbage"),
    ],
)
def test_what_is_no_recording_is_refused(
    tmp_path: Path, name: str, content: bytes | None, fault: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(TeleoperatorError) as error:
        read_actions(tmp_path / name)
    assert error.value.fault == fault


@examples(100)
@given(st.sampled_from([".npz", ".csv", ".parquet"]), st.binary(max_size=300))
def test_any_bytes_end_in_a_typed_error_or_in_actions(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    path.write_bytes(data)
    try:
        assert read_actions(path).shape[1] == len(AXES)
    except TeleoperatorError:
        return


def test_several_episodes_need_a_choice(tmp_path: Path) -> None:
    for episode in (None, 7):
        with pytest.raises(TeleoperatorError, match=r"\[3, 4\]"):
            read_actions(write(tmp_path, ".npz"), episode)


def test_a_file_that_jumps_and_a_robot_elsewhere_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "jump.npz"
    np.savez(path, action=np.vstack([ROWS, ROWS[-1:] + np.array([0, 0, 0.1, 0, 0])]))
    with pytest.raises(TeleoperatorError, match="row 8"):
        ours.UniforceReplay(ours.UniforceReplayConfig(path=str(path), calibration_dir=tmp_path)).connect()
    np.savez(path, action=ROWS)
    replay = ours.UniforceReplay(ours.UniforceReplayConfig(path=str(path), calibration_dir=tmp_path))
    replay.connect()
    with pytest.raises(TeleoperatorError) as error:
        replay.start_from(ROWS[0] + np.array([0.1, 0, 0, 0, 0]))
    assert error.value.fault == "far"


def test_the_expert_outside_the_simulation_says_so(tmp_path: Path) -> None:
    expert = ours.UniforceExpert(ours.UniforceExpertConfig(calibration_dir=tmp_path))
    with pytest.raises(TeleoperatorError, match="simulated scene") as error:
        expert.connect()
    assert error.value.fault == "simulation_only" and not expert.is_connected


def test_the_expert_steers_its_scene_as_without_the_teleoperator(connected: Callable[[str], Any]) -> None:
    from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert

    alone, plain = WipeEnv("easy"), WipeExpert()
    alone.start(0)
    plain.reset(alone)
    expert = connected("uniforce_expert")
    env = expert._scene()
    expert.start_from(env.state)
    for _ in range(5):
        action = np.array(list(expert.get_action().values()), np.float32)
        assert np.array_equal(action, plain.act(alone))
        env.advance(action)
        alone.advance(action)
