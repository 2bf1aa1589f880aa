"""Blind scripts: the same sequence without touch, eyes included. If one wiped well, touch would not be needed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lerobot_env_uniforce_wiping.blind_hands import STYLES, BlindSettings, blind_hands
from lerobot_env_uniforce_wiping.look_back import look_back
from lerobot_env_uniforce_wiping.sequence import WipeSequence
from uniforce_vtla.errors import ContractError, expected

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv

# of the sweep in docs/results/blind_scripts.json
BEST = "open_loop", BlindSettings(press_N=7.0, grip_N=13.0)


class BlindScript:
    """A script of one style and one pair of set points, with the expert's own sequence and layout."""

    def __init__(self, style: str, settings: BlindSettings) -> None:
        if style not in STYLES:
            raise ContractError(expected("style", " | ".join(STYLES), repr(style), "Name one."))
        self._style, self._settings = style, settings

    def reset(self, env: WipeEnv) -> None:
        """Start a new episode."""
        hands = blind_hands(self._style, env.level.layout, self._settings)
        self._sequence = WipeSequence(env.level, hands, env.state.astype(np.float64), lambda: look_back(env))

    @property
    def phase(self) -> str:
        """What it is doing, one of ``sequence.PHASES``."""
        return self._sequence.phase

    def act(self, env: WipeEnv) -> np.ndarray:
        """Return the next absolute target (5,) float32 from the measured state alone."""
        return self._sequence.next(env.state.astype(np.float64)).astype(np.float32)
