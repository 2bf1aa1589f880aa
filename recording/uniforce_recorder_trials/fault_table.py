"""What can break while an episode runs: how it is broken and mended, and what has to come of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from uniforce_recorder_trials.rig import Rig

Hand = Callable[[Rig], object]


@dataclass(frozen=True)
class Breakage:
    """A fault of a device, injected while an episode runs.

    Attributes:
        breaks, mends: what is done to the stand-ins.
        labels: the episode may be stored with; the first one names the cause exactly, another one is what may be seen
            first: silence comes before its reason.
        clears: whether a person has to press ``v`` before the next episode.
    """

    breaks: Hand
    mends: Hand
    labels: tuple[str, ...]
    clears: bool = False


def _camera(fault: str) -> Hand:
    return lambda rig: rig.cameras["front"].inject(fault)


def _uskin(fault: str) -> Hand:
    return lambda rig: rig.uskin.inject(fault)


MEND_CAMERA, MEND_USKIN = _camera("none"), _uskin("none")
BREAKAGES: dict[str, Breakage] = {
    "camera_stops": Breakage(_camera("stop"), MEND_CAMERA, ("aborted:lost_camera", "aborted:stale_camera")),
    "camera_goes_silent": Breakage(
        _camera("stall"), MEND_CAMERA, ("aborted:stale_camera", "aborted:lost_camera")
    ),
    "camera_freezes": Breakage(_camera("freeze"), MEND_CAMERA, ("aborted:frozen_camera",)),
    "uskin_garbage": Breakage(_uskin("garbage"), MEND_USKIN, ("aborted:bad_touch",)),
    "uskin_stalls": Breakage(_uskin("stall"), MEND_USKIN, ("aborted:stale_touch",)),
    "uskin_loses_taxels": Breakage(_uskin("missing"), MEND_USKIN, ("aborted:stale_touch",)),
    "uskin_unplugged": Breakage(_uskin("unplug"), MEND_USKIN, ("aborted:lost_touch", "aborted:stale_touch")),
    "arm_reflex": Breakage(
        lambda rig: rig.arm.do("reflex"), lambda rig: None, ("aborted:robot_reflex",), True
    ),
}
