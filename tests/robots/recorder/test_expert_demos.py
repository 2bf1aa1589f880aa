"""The scripted expert's demonstrations, with its rollouts replaced."""

from types import SimpleNamespace

import numpy as np
import pytest

from uniforce_datasets.source import read_source
from uniforce_datasets.synthetic import synthetic_frame
from uniforce_robots.recorder import expert_demos
from uniforce_vtla.errors import ContractError, RobotError, SensorError
from uniforce_vtla.keys import SEED

SCENE = SimpleNamespace(
    sensors={"left": "gelsight", "right": "tactip"}, metadata={"render_fps": 30}
)


@pytest.fixture
def record(monkeypatch, tmp_path):
    """Return a function: record episodes, of which some seeds raise an error → how many are new."""

    def recorded(errors, episodes):
        def stand_in(env, recorder, seed):
            rng = np.random.default_rng(seed)
            for step in range(3):
                recorder.add(synthetic_frame(step, rng), "wipe the dots")
            if seed in errors:
                raise errors[seed]
            return SimpleNamespace(clean=True, outcome="success")

        monkeypatch.setattr(expert_demos, "record_episode", stand_in)
        root = tmp_path / "demos"
        return expert_demos.record_expert(SCENE, root, "local/demos", episodes, 0, False, {})

    return recorded


def test_a_scene_with_a_refused_frame_is_left_out(record, tmp_path, caplog):
    errors = {0: SensorError("no markers"), 2: RobotError("the tool fell", fault="grasp_lost")}
    assert record(errors, episodes=2) == 2
    columns = read_source(tmp_path / "demos").columns((SEED,))
    assert sorted(set(columns[SEED].ravel())) == [1, 3]
    assert "seed 0 is left out: no markers" in caplog.text


def test_scenes_that_all_fail_end_with_the_reason(record):
    errors = {seed: SensorError("no markers") for seed in range(10)}
    with pytest.raises(ContractError, match="no markers"):
        record(errors, episodes=2)
