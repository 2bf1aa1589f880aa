"""Measure the shear scale of sensor units in several scenes, beside a known TacTip.

The expert wipes by the true wrench, so every unit feels the same forces. Each unit is scored three ways: as it is,
weighed through the tool, and scaled beside the anchor in the first half of the scenes, which isn't scored. The spread
of slopes over units and scenes shows whether a gain belongs to the unit or to the scene.
"""

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from joblib import delayed

from benchmarks.ledger import played, update
from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.readings import encode_now, shipped_reader
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_cli.boundary import Gripper, Level, command, one_thread, worker_process
from uniforce_cli.calibrate import CalibrateCommand, weigh_sensor
from uniforce_vtla.arguments import choose
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.options import Count, OutFile, OutFolder, Seed, Text, Workers
from uniforce_vtla.tokenizer.gains import shear_gain

ANCHOR = "tactip"  # worn on the left finger; its head reads both
KINDS = ("tactip", "uskin", "gelsight")
FIRST_UNIT = 2  # unit 1 is the demonstrations'
EVERY = 4  # steps between two readings
GRIPPED_N = 1.0
FEWEST_SCENES = 4
SCALED = ("as it is", "weighed through the tool", "beside the anchor")


@dataclass
class ShearScaleCommand:
    """Read units of each kind while the expert wipes, and fit their readings to the true shear.

    Example: python -m benchmarks.gates.shear_scale units=10 scenes=4 out=docs/results/reading_expert.json
    """

    level: Level = "touch"
    gripper: Gripper = "hand"  # of the scene
    units: Count = 10  # of each kind
    scenes: Count = 4  # of each unit, the same for all; the first half scales beside the anchor
    first_seed: Seed = BLOCKS["shear scale"].start
    only: Text = ""  # kinds, comma between them; all when empty
    workers: Workers = 2
    work: OutFolder = "outputs/shear_scale"  # readings so far: run it again to go on
    out: OutFile = "outputs/reading_expert.json"  # only its key ``shear_scale`` changes


@dataclass(frozen=True)
class Row:
    """Moments of one episode in which the tool was held, n of each list, shear along canonical y in N."""

    cell: str  # the unit
    seed: int
    read_N: list[float]  # of the unit
    truth_N: list[float]  # on its pad a step before, which is what a worn sensor shows
    anchor_N: list[float]  # read of the anchor
    press_N: list[float]  # of the eraser on the board
    refused: int  # frames that no canonicalizer takes


def play(worn: str, level: str, gripper: str, seed: int) -> Row:
    """Let the expert wipe by the true wrench; read both fingers every few steps."""
    worker_process()
    tokenizer, head = shipped_reader()
    env = WipeEnv(level, left_sensor=ANCHOR, right_sensor=worn, gripper=gripper)
    read_N, truth_N, anchor_N, press_N = [], [], [], []
    refused = 0
    now_N: np.ndarray = np.zeros(3)
    for step, _ in enumerate(walk(env, WipeExpert(), seed)):
        before_N, now_N = now_N, env.true_wrench()["right"][:3]
        if step % EVERY or now_N[2] < GRIPPED_N:
            continue
        try:
            shear = {
                finger: float(head(encode_now(env, finger, tokenizer))[0, 1]) for finger in FINGERS
            }
        except SensorError:
            refused += 1
            continue
        read_N.append(round(shear["right"], 4))
        anchor_N.append(round(shear["left"], 4))
        truth_N.append(round(float(before_N[1]), 4))
        press_N.append(round(env.sim.press_N, 4))
    return Row(worn, seed, read_N, truth_N, anchor_N, press_N, refused)


def line(read_N: np.ndarray, truth_N: np.ndarray) -> tuple[float, float]:
    """Return slope and offset in N of readings (n,) over the truth (n,)."""
    slope, offset_N = np.polyfit(truth_N, read_N, 1)
    return float(slope), float(offset_N)


def shares(slopes: np.ndarray) -> dict[str, float]:
    """Return the spread of (units, scenes) slopes: of the unit, of the scene, and what is neither.

    Two-way analysis of variance without replication; a component that comes out negative is 0.
    """
    units, scenes = slopes.shape
    by_unit, by_scene, mean = slopes.mean(axis=1), slopes.mean(axis=0), slopes.mean()
    rest = slopes - by_unit[:, None] - by_scene[None, :] + mean
    rest_var = float((rest**2).sum() / ((units - 1) * (scenes - 1)))
    unit_var = max(float(by_unit.var(ddof=1)) - rest_var / scenes, 0.0)
    scene_var = max(float(by_scene.var(ddof=1)) - rest_var / units, 0.0)
    return {"unit_sd": unit_var**0.5, "scene_sd": scene_var**0.5, "rest_sd": rest_var**0.5}


def gain_beside(rows: list[dict[str, Any]]) -> float | None:
    """Return a unit's gain from wipes beside the anchor, None where they don't give one."""
    read_N, anchor_N = (
        np.concatenate([row[name] for row in rows]) for name in ("read_N", "anchor_N")
    )
    try:
        return shear_gain(read_N, anchor_N)
    except ContractError:
        return None


def scored(rows: list[dict[str, Any]], weighed: float | None) -> dict[str, Any]:
    """Return what a unit reads in the second half of its scenes, by each way to scale it; offsets of a press in N."""
    in_order = sorted(rows, key=lambda row: row["seed"])
    half = len(in_order) // 2
    gains = dict(zip(SCALED, (1.0, weighed, gain_beside(in_order[:half])), strict=True))
    # (scenes, 2)
    lines = np.array([line(np.array(row["read_N"]), np.array(row["truth_N"])) for row in in_order])
    found: dict[str, Any] = {
        "slopes": lines[:, 0].tolist(),
        "refused": sum(row["refused"] for row in rows),
    }
    for name, gain in gains.items():
        if gain is not None:
            slope, offset_N = gain * lines[half:].mean(axis=0)
            found[name] = {"gain": gain, "press_share": slope, "press_offset_N": 2 * offset_N}
    return found


def table(units: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of a kind over its units."""
    found: dict[str, Any] = {
        "units": len(units),
        "of_slopes": shares(np.array([unit["slopes"] for unit in units])),
    }
    for name in SCALED:
        scaled = [unit[name] for unit in units if name in unit]
        found[name] = {"units": len(scaled)} | (_figures(scaled) if scaled else {})
    return found


def _figures(scaled: list[dict[str, float]]) -> dict[str, Any]:
    """Return mean, spread and range over units."""
    share = np.array([one["press_share"] for one in scaled])
    offset_N = np.array([one["press_offset_N"] for one in scaled])
    return {
        "press_share": float(share.mean()),
        "press_share_sd": float(share.std(ddof=1)) if len(share) > 1 else None,
        "press_share_range": [float(share.min()), float(share.max())],
        "press_offset_N": float(offset_N.mean()),
        "press_offset_range_N": [float(offset_N.min()), float(offset_N.max())],
    }


def in_words(one: dict[str, Any]) -> str:
    """Return a line of the table in words."""
    if not one["units"]:
        return "no unit could be scaled so"
    low, high = one["press_share_range"]
    share = f"press × {one['press_share']:.2f} [{low:.2f}, {high:.2f}]"
    return f"{one['units']:3} units: {share}, offset {one['press_offset_N']:+.2f} N"


def weighed_gain(worn: str) -> float | None:
    """Return the gain of a simulated weighing through the tool, None where it is refused."""
    try:
        return weigh_sensor(
            CalibrateCommand(worn, loads_N="3,6,9", through="tool"), shipped_reader()[0]
        ).gain
    except (ContractError, SensorError):
        return None


@command(ShearScaleCommand)
def main(config: ShearScaleCommand) -> None:
    """Play what is lacking, weigh each unit, write the table."""
    one_thread()
    if config.units < 2 or config.scenes < FEWEST_SCENES:
        came = f"{config.units} and {config.scenes}"
        wanted = f"two or more and {FEWEST_SCENES} or more"
        raise ContractError(
            expected(
                "units and scenes", wanted, came, "Half of the scenes scale, the others are scored."
            )
        )
    kinds = choose(dict.fromkeys(KINDS), config.only)
    units = {
        kind: [f"{kind}:{FIRST_UNIT + number}" for number in range(config.units)] for kind in kinds
    }
    seeds = range(config.first_seed, config.first_seed + config.scenes)

    def episodes() -> Iterator[tuple[str, int, Any]]:
        for seed in seeds:
            for worn in (worn for kind in kinds for worn in units[kind]):
                yield worn, seed, delayed(play)(worn, config.level, config.gripper, seed)

    rows = defaultdict[str, list[dict[str, Any]]](list)
    for row in played(
        Path(config.work) / f"{config.level}_{config.gripper}.jsonl", episodes(), config.workers
    ):
        if row["seed"] in seeds:
            rows[row["cell"]].append(row)
    by_unit = {
        worn: scored(rows[worn], weighed_gain(worn)) for kind in kinds for worn in units[kind]
    }
    found = {kind: table([by_unit[worn] for worn in units[kind]]) for kind in kinds}
    for kind, figures in found.items():
        for name in SCALED:
            print(f"{kind:9} {name:26} {in_words(figures[name])}")
        print(f"{kind:9} spread of slopes: {figures['of_slopes']}")
    content = {
        "level": config.level,
        "gripper": config.gripper,
        "scenes": [seeds[0], seeds[-1]],
        "kinds": found,
    }
    content["by_unit"] = by_unit
    print(f"written to {update(Path(config.out), 'shear_scale', content)}")


if __name__ == "__main__":
    sys.exit(main())
