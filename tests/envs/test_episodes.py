"""A scripted episode ends by itself, also where the hand loses the tool."""

from unittest.mock import Mock

import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import run_script
from uniforce_vtla.errors import RobotError

SEED = 29_200


class LosesTheTool(WipeExpert):
    """The expert, whose tool is taken out of the hand while it carries it."""

    def act(self, env):
        if self.phase == "carry":
            address = int(env.sim.model.joint("eraser").qposadr[0])
            env.sim.data.qpos[address : address + 3] = (0.2, 0.4, 0.1)
        return super().act(env)


def test_a_lost_tool_aborts_the_episode():
    result = run_script(WipeEnv("touch", drawn=(), gripper="hand"), LosesTheTool(), SEED)
    assert result.outcome == "aborted" and not result.clean
    assert "in_band_share" in result.metrics  # scored as far as it went


def test_another_fault_of_the_hand_is_raised():
    script = Mock()
    script.act.side_effect = RobotError("hand: no answer", "hand_connection")
    with pytest.raises(RobotError, match="no answer"):
        run_script(WipeEnv("touch", drawn=()), script, SEED)
