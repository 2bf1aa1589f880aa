"""Roll faults out, and join them into one table."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.actors import Arm
from benchmarks.stress.disturbed import EXCHANGED
from benchmarks.stress.operators import OPERATORS
from benchmarks.stress.page import monitor_row, one_table
from benchmarks.stress.rollouts import (
    Doses,
    cells_of,
    near_cliffs,
    of_the_scene,
    repeatability,
    roll,
    summarise,
)
from benchmarks.stress.warning import warned
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command
from uniforce_cli.score import content_of
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import (
    Count,
    CountOrZero,
    FolderPath,
    OutFile,
    OutFolder,
    Policies,
    Seed,
    Text,
    Workers,
    split,
)
from uniforce_vtla.results_file import provenance, write_json


@dataclass
class StressCommand:
    """Roll out the faults that the stored screen puts near a cliff; make one table.

    Example: python -m benchmarks.stress policy=arms/vt/seed0,arms/vt/seed1 blind=arms/v/seed0
    Then: python -m benchmarks.stress part=page out=docs/results/stress.json
    """

    part: Literal["rollouts", "page"] = "rollouts"
    # worn on the right finger, comma between them; the policy's own first
    sensors: Text = "tactip:1,uskin:2"
    level: Level = "touch"
    policy: Policies = "shipped"  # rollouts: checkpoint folders that take turns
    # rollouts: checkpoint folders of a policy without touch; it acts where a scene's fault is
    blind: Text = ""
    stock: Text = ""  # rollouts: checkpoint folders of any LeRobot policy of cameras and state
    calibrations: FolderPath = ""  # rollouts: of exchanged sensors, uskin-2 …; "" = they wear none
    rollouts: Count = 40  # scenes, the same for every cell
    # doses per operator near a cliff, beside the named one; 0 = the named ones alone
    near: CountOrZero = 3
    benign: Count = 4  # of them with a dose that changes nothing, and without touch
    first_seed: Seed = 0  # 0 = the benchmark's own block
    only: Text = ""  # rollouts: just these operators, comma between them; "" = all
    # rollouts: just arms whose names begin with one of these; rows of the others are kept
    acting: Text = ""
    workers: Workers = 2
    # stress_screen.json; page: also monitor.json and wiping.json
    facts: FolderPath = "docs/results"
    # results of the parts; episodes so far: run it again to go on
    work: OutFolder = "outputs/stress"
    out: OutFile = ""  # "" = WORK/PART.json

    @property
    def result(self) -> Path:
        return Path(self.out or Path(self.work) / f"{self.part}.json")


OF_ROLLOUTS = ("policy", "blind", "stock", "calibrations")  # options that the page doesn't use
# a new reference in free air can mend these: also rolled out without the monitor that takes it
MENDED = ("C2 shift", "C3 turn", "M2 flicker", "R1 stale reference")
# calibrations that can undo a fault's dose: how made → ending of its folder, operator → doses
CALIBRATED: dict[str, tuple[str, Doses]] = {
    "calibrated": (
        "",
        {"G1 stiffer": [1.6], "G1 softer": [0.4], "G2 keener": [1.6], "G2 duller": [0.4]},
    ),
    "weighed": (
        "-loads",
        {
            "G1 stiffer": [1.3, 1.6],
            "G1 softer": [0.7, 0.4],
            "G2 keener": [1.3, 1.6],
            "G2 duller": [0.7, 0.4],
        },
    ),
}


def arms(config: StressCommand) -> list[tuple[Arm, Doses]]:
    """Return each arm with the doses of the operators it meets, the policy's own sensor first."""
    screened = _facts(config, "stress_screen")["screened"]
    policies = tuple(split(config.policy))
    blind = tuple(split(config.blind))
    stock = tuple(split(config.stock))
    scene = of_the_scene(config.near)
    own, *others = split(config.sensors)
    doses = {sensor: near_cliffs(screened[sensor], config.near) for sensor in (own, *others)}

    found = [(Arm(f"policy on {own}", own, "policy", policies), doses[own] | scene)]
    unwatched = {name: near for name, near in doses[own].items() if name in MENDED}
    found.append((Arm("policy without monitor", own, "policy", policies, monitor="off"), unwatched))
    for how, (ending, wanted) in CALIBRATED.items():
        there = _calibrated_doses(config, own + ending, wanted)
        if there:
            worn = _calibration(config, own + ending)
            name = f"policy on {own}, {how}"
            found.append((Arm(name, own, "policy", policies, worn, refitted=True), there))
    not_exchanged = {name: near for name, near in scene.items() if name != EXCHANGED}
    for sensor in others:
        worn = _calibration(config, sensor)
        arm = Arm(f"policy on {sensor}", sensor, "policy", policies, worn)
        found.append((arm, doses[sensor] | not_exchanged))
    for sensor, near in doses.items():
        found.append((Arm(f"expert reads {sensor}", sensor, "reads"), near))
    found.append((Arm("expert", acts="expert"), scene))
    if blind:
        found.append((Arm("policy without touch", acts="policy", policies=blind, few=True), scene))
    if stock:
        found.append((Arm("stock policy", acts="stock", policies=stock, few=True), scene))

    only = split(config.only)
    if only:
        found = [(arm, {n: d for n, d in near.items() if n in only}) for arm, near in found]
    return found


def _facts(config: StressCommand, name: str) -> dict[str, Any]:
    return read_object(Path(config.facts) / f"{name}.json", ContractError)


def _calibrated_doses(config: StressCommand, sensor: str, wanted: Doses) -> Doses:
    """Return the doses for which there is a calibration with the fault."""
    there: Doses = {}
    for operator, doses in wanted.items():
        for dose in doses:
            if _calibration(config, sensor, operator, dose):
                there.setdefault(operator, []).append(dose)
    return there


def _calibration(config: StressCommand, sensor: str, operator: str = "", dose: float = 0.0) -> str:
    """Return the folder of a sensor's calibration, as it is or with a fault; "": there is none."""
    words = sensor
    if operator:
        words += OPERATORS[operator].words(dose)
    folder = Path(config.calibrations, words.replace(":", "-"))
    return str(folder) if config.calibrations and folder.is_dir() else ""


def check_ledger(folder: Path, acting: list[Arm]) -> None:
    """Note in a ledger's folder what acts; ContractError: its episodes are of other policies."""
    now = {
        arm.name: [content_of(name) for name in (*arm.policies, arm.calibration) if name]
        for arm in acting
    }
    path = folder / "acts.json"
    before = read_object(path, ContractError) if path.is_file() else {}
    if others := [name for name in now if before.get(name, now[name]) != now[name]]:
        do = "Name another folder: work=…"
        raise ContractError(
            expected(f"episodes in {folder}", "of these policies", f"other ones' of {others}", do)
        )
    write_json(path, before | now)


def roll_out(config: StressCommand) -> dict[str, Any]:
    first = config.first_seed or BLOCKS["stress"].start
    seeds = range(first, first + config.rollouts)
    who = arms(config)
    check_ledger(Path(config.work), [arm for arm, _ in who])
    cells = {arm.name: cells_of(arm, doses) for arm, doses in who}
    every = [cell for of_arm in cells.values() for cell in of_arm]
    ledger = Path(config.work) / "episodes.jsonl"
    acting = tuple(split(config.acting)) or ("",)
    rows = roll(every, config.level, seeds, config.workers, ledger, config.benign, acting)
    own = {cell.fault: cell.name for cell in next(iter(cells.values()))}
    warnings = {}
    for cell in cells["policy without monitor"]:
        if cell.operator and not cell.benign:
            warnings[cell.fault] = warned(rows[own[cell.fault]], rows[cell.name])
    return {
        "seeds": [seeds[0], seeds[-1]],
        "repeatability": repeatability(every, rows),
        "warned": warnings,
        "arms": {name: summarise(of_arm, rows) for name, of_arm in cells.items()},
    }


def page(config: StressCommand) -> dict[str, Any]:
    """Return the form of stress.json."""
    rolled = read_object(Path(config.work) / "rollouts.json", ContractError)
    screened = _facts(config, "stress_screen")["screened"]
    without_touch = _facts(config, "wiping")["arms"]["V"]
    content = {name: rolled[name] for name in ("seeds", "repeatability")}
    content |= one_table(rolled["arms"], screened, without_touch)
    kind = wear(split(config.sensors)[0])(0).kind
    noticed = _facts(config, "monitor")["kinds"][kind]
    content["monitor"] = monitor_row(rolled["arms"], noticed, rolled["warned"])
    return content


def check_used(config: StressCommand) -> None:
    """Refuse an unused option, and a policy that is none; raises ContractError, CheckpointError."""
    if config.part == "rollouts":
        for policy in split(config.policy):
            content_of(policy)
        return
    for name in OF_ROLLOUTS:
        if getattr(config, name) != getattr(StressCommand, name):
            do = "Leave it out, or name that part."
            raise ContractError(expected(name, "part=rollouts with it", f"part={config.part}", do))


@command(StressCommand)
def main(config: StressCommand) -> None:
    check_used(config)
    content: dict[str, Any] = {
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
    }
    if config.part == "rollouts":
        content |= roll_out(config)
        _print_arms(content["arms"])
    else:
        content |= page(config)
    print(f"written to {write_json(config.result, content | provenance())}")


def _print_arms(found: dict[str, Any]) -> None:
    for name, operators in found.items():
        print(f"{name}: {operators['']['clean']} of {operators['']['n']} clean without a fault")
        for operator, row in operators.items():
            if not operator:
                continue
            clean = ""
            for dose, count in zip(row["doses"], row["clean"], strict=True):
                clean += f"  {dose:g}: {count}"
            breaks = "too few scenes to judge"
            if row["judged"]:
                breaks = f"breaks at {row['breaking_dose']}"
            print(f"  {operator:30} benign {row['benign']}{clean}  {breaks}")


if __name__ == "__main__":
    sys.exit(main())
