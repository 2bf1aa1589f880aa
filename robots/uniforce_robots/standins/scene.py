"""Contacts of a stand-in's pad: free air, then a ball that presses and leaves, over and over.

Signals come from the project's contact simulator, to check device → canonicalizer → tokenizer.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import interp1d

from uniforce_vtla.contact import TactileSimulator, free_air, gap_maps
from uniforce_vtla.contracts import QUARTERS, ContactState
from uniforce_vtla.errors import ContractError, expected, require_one_of

# contact states per press that are simulated; taxel scans between them are interpolated
KEY_STATES = 48
TAXEL_NOISE_COUNTS = 2.0  # of real patches at rest: 1 to 5


@dataclass
class Scene:
    """One cycle of touching, of every tactile stand-in; each adds its own settings."""

    rest_s: float = 1.0  # free air at the start of each cycle
    press_s: float = 2.0  # then a press that comes and goes; 0 = never
    peak_N: float = 8.0  # its strongest normal force
    shear_N: tuple[float, float] = (1.0, 0.0)  # x and y at the peak, image axes
    # centre | top-left | top-right | bottom-left | bottom-right, in the marker image
    where: str = "centre"
    hold: bool = False  # pressed from the start and for ever
    seed: int = 0  # of unit and noise

    def load_share(self, rate_hz: float) -> np.ndarray:
        """Return (N,) in 0 … 1: how much of the peak is there at each step of the cycle."""
        period_s = self.rest_s + self.press_s
        steps = max(2, round(period_s * rate_hz))
        if self.hold:
            return np.ones(steps)
        t = np.linspace(0, period_s, steps, endpoint=False)
        phase = np.clip((t - self.rest_s) / max(self.press_s, 1e-9), 0, 1)
        return np.sin(np.pi * phase) ** 2 * (self.press_s > 0)


def taxel_cycle(scene: Scene, rate_hz: float) -> np.ndarray:
    """Return (N, 16, 3) uint16 raw counts of one cycle at ``rate_hz``, noise included."""
    simulator = TactileSimulator("uskin", seed=scene.seed)
    simulator.raw_frames(free_air(1))
    share = scene.load_share(rate_hz)
    keys = np.linspace(0, 1, KEY_STATES)
    # (K, 16, 3)
    counts = simulator.raw_frames(_contacts(simulator, scene, keys)).astype(np.float64)
    counts[0] = simulator.raw_reference()
    smooth = interp1d(keys, counts, axis=0)(share)
    noise = np.random.default_rng(scene.seed).normal(0, TAXEL_NOISE_COUNTS, smooth.shape)
    return np.clip(np.rint(smooth + noise), 0, 65_535).astype(np.uint16)


def frame_cycle(sensor: str, scene: Scene, rate_hz: float) -> np.ndarray:
    """Return (N, 480, 640, 3) uint8 RGB raw frames of one cycle of a camera sensor.

    Raises ContractError: a sensor that isn't a camera.
    """
    simulator = TactileSimulator(sensor, seed=scene.seed)
    if simulator.spec.signal != "camera":
        raise ContractError(
            expected("sensor", "a camera sensor", sensor, "Use the slcan or xela stand-in.")
        )
    return simulator.raw_frames(_contacts(simulator, scene, scene.load_share(rate_hz)))


def _contacts(simulator: TactileSimulator, scene: Scene, share: np.ndarray) -> ContactState:
    """Return one contact per entry of ``share`` (B,): free air where it is 0."""
    require_one_of("where", scene.where, ("centre", *QUARTERS), "Name a place on the pad.")
    row, _, column = scene.where.partition("-")
    place = np.array(
        [{"left": -1, "right": 1}.get(column, 0), {"top": -1, "bottom": 1}.get(row, 0)]
    )
    centre_mm = place * np.asarray(simulator.spec.pad_size_mm) / 4
    B = len(share)
    gap = gap_maps(["sphere"] * B, np.tile(centre_mm, (B, 1)), np.zeros(B), np.ones(B))
    gap[share <= 0] = np.inf
    force = np.outer(share, (*scene.shear_N, scene.peak_N)).astype(np.float32)
    return ContactState(gap.astype(np.float32), force, np.zeros(B, np.float32))
