"""How each teleoperator is made for a test."""

import numpy as np
from lerobot.teleoperators import make_teleoperator_from_config

import uniforce_robots.teleop as ours
from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad
from uniforce_robots.teleop.gello import tool_axes


def next_axes(device):
    return np.array(list(device.get_action().values()))


def home_axes():
    return np.array([*tool_axes(HOME_q_rad, float(HAND_TO_FLANGE[2, 3])), 0.08])


# name: config, and which setting is the address of which stand-in
CONFIGS = {
    "uniforce_keyboard": (ours.UniforceKeyboardConfig, {}),
    "uniforce_hand_guide": (ours.UniforceHandGuideConfig, {}),
    "uniforce_spacemouse": (ours.UniforceSpaceMouseConfig, {"device": "spacemouse"}),
    "uniforce_gello": (ours.UniforceGelloConfig, {"port": "gello"}),
}


def make(name, request, folder):
    config, standins = CONFIGS[name]
    where = {
        setting: request.getfixturevalue(standin).address for setting, standin in standins.items()
    }
    return make_teleoperator_from_config(config(calibration_dir=folder, **where))
