"""Controls change the touch that a policy gets, and nothing else."""

from typing import Any

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_cli.score import ScoreConfig
from uniforce_cli.score_worker import Job, ShuffledTouch, controlled, donated_touch, score_job
from uniforce_vtla.errors import ContractError
from uniforce_vtla.keys import TACTILE_NAMES


class Watching:
    """A controller that keeps what it was shown."""

    def __init__(self) -> None:
        self.seen: list[dict[str, Any]] = []

    def reset(self, env: object) -> None:
        self.seen = []

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        self.seen.append(observation)
        return np.zeros((1, 5))


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0, 2])
def test_shuffled_touch_is_another_scenes_in_the_same_phase(phase: int, monkeypatch: pytest.MonkeyPatch) -> None:
    bank = donated_touch("easy", {"left": "gelsight", "right": "tactip"}, donors=1)
    assert set(bank) == {0, 1, 2, 3}
    monkeypatch.setattr(WipeEnv, "phase", phase)
    watching, env = Watching(), WipeEnv("easy")
    observation, _ = env.reset(seed=3)
    shuffled = ShuffledTouch(watching, bank)
    for _ in range(2):  # the same scene gets the same other scene's touch
        shuffled.reset(env)
        shuffled.chunk(observation, "wipe")
        seen = watching.seen[0]
        images = {name: seen["pixels"][name] for name in TACTILE_NAMES}
        assert all(i.shape == (480, 640, 3) and set(np.unique(i)) <= {0, 255} for i in images.values())
        packed = {n: np.packbits(image[..., 0] > 0, axis=-1) for n, image in images.items()}
        assert any(all(np.array_equal(packed[n], donor[n]) for n in TACTILE_NAMES) for donor in bank[phase])
        assert np.array_equal(seen["pixels"]["front"], observation["pixels"]["front"])
        assert np.array_equal(seen["agent_pos"], observation["agent_pos"])
    if phase == 2:  # pressed on the board there, in free air here
        assert not np.array_equal(images["tactile_left"], observation["pixels"]["tactile_left"])


def test_unknown_controls_and_controls_of_scripts_are_refused(tmp_path: Any) -> None:
    with pytest.raises(ContractError, match="masked"):
        controlled(None, "asleep", WipeEnv("easy"))  # type: ignore[arg-type]
    job = Job(0, ScoreConfig(policy="expert", control="masked", out=str(tmp_path)), 1)
    with pytest.raises(ContractError, match="Controls are for policies"):
        score_job(job)
