"""Hand guiding with impedance, the paper's way: a person leads the soft arm, and the measured pose is the action.

The arm needs ``HAND_GUIDED`` gains: soft but along the closing axis, so that a squeeze does not drag it. Since the
target follows the measured pose, nothing pulls the arm back; what its gravity model leaves over lets it creep slowly.
Never run on hardware.
"""

from __future__ import annotations

import numpy as np

from uniforce_robots.franka.arm import HAND_GUIDED
from uniforce_robots.teleop.base import FEEDBACK_AGE_S
from uniforce_robots.teleop.configs import UniforceHandGuideConfig
from uniforce_robots.teleop.keyed import WIDTH, WIDTH_KEYS, KeyedTeleoperator
from uniforce_vtla.errors import TeleoperatorError, expected


class UniforceHandGuide(KeyedTeleoperator):
    """The measured x, y, z and yaw, and a width commanded by the keys o (open) and p (close)."""

    config_class = UniforceHandGuideConfig
    name = "uniforce_hand_guide"
    wants_gains = HAND_GUIDED

    def __init__(self, config: UniforceHandGuideConfig) -> None:
        super().__init__(config, config.limits, WIDTH_KEYS)

    def _next(self, elapsed_s: float) -> np.ndarray:
        measured = self.measured
        if measured is None:
            wanted = f"a measured pose younger than {FEEDBACK_AGE_S} s"
            do = "Call send_feedback(observation) before each get_action()."
            raise TeleoperatorError(expected("hand guiding", wanted, "none", do), "stale")
        width = self.integrator.advance(self.keys.rates(), elapsed_s, measured)[WIDTH]
        return np.array([*measured[:WIDTH], width])
