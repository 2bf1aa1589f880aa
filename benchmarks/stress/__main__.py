"""Screen the operators, roll them out, draw the page."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.actors import Arm
from benchmarks.stress.balance import SCALE
from benchmarks.stress.disturbed import EXCHANGED
from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.other_readers import Readers, fit_readers
from benchmarks.stress.page import draw, monitor_row, one_table
from benchmarks.stress.rollouts import (
    cells_of,
    near_cliffs,
    of_the_scene,
    repeatability,
    roll,
    summarise,
)
from benchmarks.stress.screen import PRESSED_N, against, others_against, screen_cell
from benchmarks.stress.warning import warned
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command, worker_process
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
from uniforce_vtla.tokenizer import ForceHead, Tokenizer


@dataclass
class StressCommand:
    """Ask of every operator and dose what would be read of a press of 6 N; roll out what is near a cliff; draw it.

    Example: python -m benchmarks.stress
    Then: python -m benchmarks.stress part=rollouts policy=arms/vt/seed0,arms/vt/seed1 blind=arms/v/seed0
    Then: python -m benchmarks.stress part=page out=docs/results/stress.json
    """

    part: Literal["screen", "rollouts", "page"] = "screen"
    # worn on the right finger, comma between them; the policy's own first
    sensors: Text = "tactip:1,uskin:2"
    level: Level = "touch"
    scenes: Count = 2  # screen: per cell
    policy: Policies = "shipped"  # rollouts: checkpoint folders that take turns
    # rollouts: checkpoint folders of a policy without touch; it acts where a scene's fault is
    blind: Text = ""
    stock: Text = ""  # rollouts: checkpoint folders of any LeRobot policy of cameras and state
    calibrations: FolderPath = ""  # rollouts: of exchanged sensors, uskin-2 …; "" = they wear none
    rollouts: Count = 40  # scenes, the same for every cell
    # doses per operator near a cliff, beside the named one; 0 = the named ones alone
    near: CountOrZero = 3
    benign: Count = 4  # of them with a dose that changes nothing, and without touch
    first_seed: Seed = 0  # 0 = screen: development scenes; rollouts: the benchmark's own block
    only: Text = ""  # rollouts: just these operators, comma between them; "" = all
    # rollouts: just arms whose names begin with one of these; rows of the others are kept
    acting: Text = ""
    workers: Workers = 2
    # page: monitor.json and wiping.json, what the monitor notices and V wipes clean
    facts: FolderPath = "docs/results"
    # results of the parts; episodes so far: run it again to go on
    work: OutFolder = "outputs/stress"
    out: OutFile = ""  # "" = WORK/PART.json

    @property
    def result(self) -> Path:
        return Path(self.out or Path(self.work) / f"{self.part}.json")


USED_BY = {"rollouts": ("policy", "blind", "stock", "calibrations"), "page": ("facts",)}
# what a new reference in free air can mend: also rolled out without the monitor that takes it
MENDED = ("C2 shift", "C3 turn", "M2 flicker", "R1 stale reference")
# whose dose a calibration with the fault can undo: how it was made → ending of its folder, and operator → doses
CALIBRATED = {
    "calibrated": (
        "",
        {"G1 stiffer": [1.6], "G1 softer": [0.4], "G2 keener": [1.6], "G2 duller": [0.4]},
    ),
    "weighed": (
        "-loads",
        {n: [*doses] for n, doses in zip(SCALE, ((1.3, 1.6), (0.7, 0.4)) * 2, strict=True)},
    ),
}
PARTS, FACTS = ("rollouts", "screen"), ("monitor", "wiping")
SCREENED_FROM = 39_700  # development scenes
READERS_LEARN = range(39_790, 39_794)  # development scenes, of the sensor without a fault


def _cell(level: str, words: str, first: int, scenes: int, readers: Readers) -> dict[str, Any]:
    worker_process()
    seeds = range(first, first + scenes)
    return screen_cell(
        level, words, seeds, Tokenizer.from_pretrained(), ForceHead.from_pretrained(), readers
    )


def _readers(level: str, words: str) -> Readers:
    worker_process()
    return fit_readers(level, words, READERS_LEARN, Tokenizer.from_pretrained(), PRESSED_N)


def screen(config: StressCommand) -> dict[str, Any]:
    cells = [(sensor, "none", 0.0, sensor) for sensor in split(config.sensors)]
    for sensor in split(config.sensors):
        for name, operator in OPERATORS.items():
            for dose in (operator.benign, *operator.doses):
                if (words := worn_with(operator, sensor, dose)) is not None:
                    cells.append((sensor, name, dose, words))
    first, sensors = config.first_seed or SCREENED_FROM, split(config.sensors)
    fitted = Parallel(config.workers)(delayed(_readers)(config.level, sensor) for sensor in sensors)
    readers = dict(zip(sensors, fitted, strict=True))
    jobs = [
        delayed(_cell)(config.level, words, first, config.scenes, readers[sensor])
        for sensor, *_, words in cells
    ]
    found = list(
        tqdm(Parallel(config.workers, return_as="generator")(jobs), total=len(jobs), desc="cells")
    )
    usual = {
        sensor: cell
        for (sensor, name, *_), cell in zip(cells, found, strict=True)
        if name == "none"
    }
    rows: dict[str, Any] = {sensor: {"none": usual[sensor]} for sensor in usual}
    for (sensor, name, dose, _), cell in zip(cells, found, strict=True):
        if name != "none":
            cell |= {"dose": dose, "press_error_N": against(cell, usual[sensor])}
            cell["others_error_N"] = others_against(cell, usual[sensor])
            rows[sensor].setdefault(name, []).append(cell)
    return rows


def arms(config: StressCommand) -> list[tuple[Arm, dict[str, list[float]]]]:
    """Return who acts, and which doses of which operators it meets. An operator stands first with its expert."""
    screened = read_object(Path(config.work) / "screen.json", ContractError)["screened"]
    policies, blind, stock = (
        tuple(split(given)) for given in (config.policy, config.blind, config.stock)
    )
    scene, (own, *others) = of_the_scene(config.near), split(config.sensors)
    doses = {sensor: near_cliffs(screened[sensor], config.near) for sensor in (own, *others)}
    found = [(Arm(f"policy on {own}", own, "policy", policies), doses[own] | scene)]
    unwatched = {name: near for name, near in doses[own].items() if name in MENDED}
    found.append((Arm("policy without monitor", own, "policy", policies, monitor="off"), unwatched))
    for how, (ending, wanted_doses) in CALIBRATED.items():
        there = {
            name: found_doses
            for name, many in wanted_doses.items()
            if (
                found_doses := [
                    dose for dose in many if _calibration(config, own + ending, name, dose)
                ]
            )
        }
        if there:
            worn = _calibration(config, own + ending)
            found.append(
                (
                    Arm(f"policy on {own}, {how}", own, "policy", policies, worn, refitted=True),
                    there,
                )
            )
    for sensor in others:
        arm = Arm(f"policy on {sensor}", sensor, "policy", policies, _calibration(config, sensor))
        found.append(
            (arm, doses[sensor] | {name: near for name, near in scene.items() if name != EXCHANGED})
        )
    found += [
        (Arm(f"expert reads {sensor}", sensor, "reads"), near) for sensor, near in doses.items()
    ]
    found.append((Arm("expert", acts="expert"), scene))
    if blind:
        found.append((Arm("policy without touch", acts="policy", policies=blind, few=True), scene))
    if stock:
        found.append((Arm("stock policy", acts="stock", policies=stock, few=True), scene))
    wanted = split(config.only)
    return [
        (arm, {n: d for n, d in doses.items() if not wanted or n in wanted}) for arm, doses in found
    ]


def _calibration(config: StressCommand, sensor: str, operator: str = "", dose: float = 0.0) -> str:
    """Return the folder of a sensor's calibration, as it is or with a fault; "" where there is none."""
    words = sensor + (OPERATORS[operator].words(dose) if operator else "")
    folder = Path(config.calibrations, words.replace(":", "-"))
    return str(folder) if config.calibrations and folder.is_dir() else ""


def check_ledger(folder: Path, acting: list[Arm]) -> None:
    """Note in the folder of a ledger what acts; ContractError: its episodes are of another policy or calibration."""
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
    who = arms(config)
    check_ledger(Path(config.work), [arm for arm, _ in who])
    cells = {arm.name: cells_of(arm, doses) for arm, doses in who}
    every = [cell for of_arm in cells.values() for cell in of_arm]
    seeds, ledger = range(first, first + config.rollouts), Path(config.work) / "episodes.jsonl"
    acting = tuple(split(config.acting)) or ("",)
    rows = roll(every, config.level, seeds, config.workers, ledger, config.benign, acting)
    (own, *_), unwatched = cells.values(), cells["policy without monitor"]
    twins = [
        (a.name, b)
        for b in unwatched
        if b.operator and not b.benign
        for a in own
        if a.fault == b.fault
    ]
    return {
        "seeds": [seeds[0], seeds[-1]],
        "repeatability": repeatability(every, rows),
        "warned": {b.fault: warned(rows[a], rows[b.name]) for a, b in twins},
        "arms": {name: summarise(of_arm, rows) for name, of_arm in cells.items()},
    }


def check_used(config: StressCommand) -> None:
    """Refuse what the part doesn't use, and a policy that is none; raises ContractError, CheckpointError."""
    for part, names in USED_BY.items():
        changed = [name for name in names if getattr(config, name) != getattr(StressCommand, name)]
        if changed and config.part != part:
            came = f"part={config.part}"
            raise ContractError(
                expected(
                    changed[0], f"part={part} with it", came, "Leave it out, or name that part."
                )
            )
    if config.part == "rollouts":
        for policy in split(config.policy):
            content_of(policy)


@command(StressCommand)
def main(config: StressCommand) -> None:
    check_used(config)
    content: dict[str, Any] = {
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
    }
    if config.part == "screen":
        content["screened"] = rows = screen(config)
        _print_screen(rows)
    elif config.part == "rollouts":
        content |= roll_out(config)
        _print_arms(content["arms"])
    else:
        rolled, screened = (
            read_object(Path(config.work) / f"{name}.json", ContractError) for name in PARTS
        )
        noticed, wiping = (
            read_object(Path(config.facts) / f"{name}.json", ContractError) for name in FACTS
        )
        content |= {name: rolled[name] for name in ("seeds", "repeatability")}
        content |= one_table(rolled["arms"], screened["screened"], wiping["arms"]["V"])
        kind = wear(split(config.sensors)[0])(0).kind
        content["monitor"] = monitor_row(rolled["arms"], noticed["kinds"][kind], rolled["warned"])
        draw(content, config.result.with_suffix(".png"))
    print(f"written to {write_json(config.result, content | provenance())}")


def _print_screen(rows: dict[str, Any]) -> None:
    for sensor, operators in rows.items():
        print(
            f"{sensor}: 6 N are read as {operators['none']['press_read_at_6_N']:.2f} N; with the fault, N more:"
        )
        for name, cells in operators.items():
            if name != "none":
                errors = {cell["dose"]: cell["press_error_N"] for cell in cells[1:]}
                said = "  ".join(
                    f"{dose:g}: " + ("refused" if N is None else f"{N:+.2f}")
                    for dose, N in errors.items()
                )
                print(f"  {name:20} [{OPERATORS[name].unit}] {said}")


def _print_arms(found: dict[str, Any]) -> None:
    for name, operators in found.items():
        print(f"{name}: {operators['']['clean']} of {operators['']['n']} clean without a fault")
        for operator, row in operators.items():
            if operator:
                clean = "  ".join(
                    f"{dose:g}: {k}" for dose, k in zip(row["doses"], row["clean"], strict=True)
                )
                breaks = (
                    f"breaks at {row['breaking_dose']}"
                    if row["judged"]
                    else "too few scenes to judge"
                )
                print(f"  {operator:30} benign {row['benign']}  {clean}  {breaks}")


if __name__ == "__main__":
    sys.exit(main())
