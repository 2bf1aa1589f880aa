"""What a demonstration stores while it is nudged."""

from typing import Any

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.disturbance import Nudge
from uniforce_robots.recorder.expert_demos import record_episode
from uniforce_vtla.keys import ACTION


class FrameList:
    """Stands in for the recorder: keeps frames."""

    def __init__(self) -> None:
        self.frames: list[dict[str, Any]] = []

    def add(self, frame: dict[str, Any], task: str) -> None:
        self.frames.append(frame)


def test_the_label_is_what_the_expert_commanded_not_what_was_executed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env, executed = WipeEnv("easy", max_steps=6), []
    step = env.step
    monkeypatch.setattr(env, "step", lambda action: (executed.append(action), step(action))[1])
    demo = FrameList()
    record_episode(env, demo, seed=3, nudge=1.3)  # type: ignore[arg-type]
    offset = Nudge(3, 1.3)
    for frame, action in zip(demo.frames, executed, strict=True):
        assert np.allclose(offset.apply(frame[ACTION]), action)
        assert not np.allclose(frame[ACTION], action, atol=1e-6)
