"""Calibrate a new sensor: by grasps beside a known one, or by presses of known load."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal, cast

from uniforce_cli.boundary import command, one_thread, refuse_unused
from uniforce_cli.paired_grasps import recorded_grasps, simulated_grasps
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import (
    Count,
    FilePath,
    FolderPath,
    Numbers,
    OutFolder,
    Pattern,
    Seed,
    Text,
    TokenizerFolder,
)
from uniforce_vtla.tokenizer.settings import OBJECT_CLASSES, CalibrationConfig

if TYPE_CHECKING:
    from uniforce_cli.known_loads import Presses
    from uniforce_robots.sensors.finger import TactileFinger
    from uniforce_vtla.tokenizer.api import Tokenizer
    from uniforce_vtla.tokenizer.calibration import Calibration
    from uniforce_vtla.tokenizer.calibration_choice import Choice
    from uniforce_vtla.tokenizer.force_head import ForceHead

Unit = Annotated[
    str,
    Pattern(
        "a sensor and which unit of it", r"\w+(:(drawing|\d{1,6}))?(\+[a-z]+=[\d.]+)*", "uskin:7"
    ),
]
TURN_DEG = 10.0  # pairs tell the angle between two fingers to a few degrees
logger = logging.getLogger(__name__)


@dataclass
class CalibrateCommand:
    """Fit a sensor to a known one by grasps, or to known loads on a kitchen scale.

    Grasps take two minutes: hold a small object from outside, let both fingers grasp it, squeeze,
    push and twist. After a minute take a tool's flat handle. Left-out grasps choose a map of the
    latent, or none.
    Record: uniforce pairs robot=franka rig=rig.yaml indenters=small,tool
    Example: uniforce calibrate new=gelsight anchor=tactip pairs=outputs/pairs/uniforce_pairs
    In simulation: uniforce calibrate new=tactip:7 anchor=tactip:1

    A kitchen scale takes half a minute. The fingers hold the task's tool; the fit is one gain of
    the latents.
    Example: uniforce calibrate new=uskin rig=rig.yaml finger=right loads_N=3,6,9 through=tool
    In simulation: uniforce calibrate new=uskin:7 loads_N=3,6,9 through=tool

    Use it: uniforce score … right_sensor=uskin right_calibration=outputs/calibration
    """

    # sensor to fit. In simulation its unit 1, or uskin:7, uskin:drawing, tactip:1+gain=1.6
    new: Unit = "gelsight_stiff"
    anchor: Unit = "tactip"  # known sensor, in the same words; its force head reads both
    # pairs recorded by `uniforce pairs`; empty = grasps are simulated
    pairs: FolderPath = ""
    # how new sat on its finger while pairs were recorded; later the rig's settings bring it upright
    mounted: Literal["upright", "turned", "mirrored_x", "mirrored_y"] = "upright"
    tools: Text = "tool,flat"  # recorded objects that count as tools; all others are small
    # objects that must agree, or the calibration is refused
    task: Literal["both", "small", "tool"] = "both"
    grasps: Count = 600  # simulated pairs
    loads_N: Numbers = ""  # three known loads or more, instead of an anchor's grasps
    # with loads_N. pad: pressed bare on a handle, for domes and taxels | tool: the held tool is
    # pressed on the scale, for every kind
    through: Literal["pad", "tool"] = "pad"
    # with loads_N: YAML file with `robot: {cameras: …}`; empty = presses are simulated
    rig: FilePath = ""
    finger: Literal["left", "right"] = "right"  # finger that wears new, in the rig
    out: OutFolder = "outputs/calibration"  # folder of the calibration
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    # shares of the grasps that judge, and agreement below which the fit is refused
    fit: CalibrationConfig = field(default_factory=CalibrationConfig)
    seed: Seed = 0  # of the grasps


def calibrate_sensor(config: CalibrateCommand, tokenizer: Tokenizer) -> Calibration:
    """Gather grasps and fit the calibration.

    Raises as ``calibrate``; SensorError: an unknown sensor; DatasetError: pairs that can't be read.
    """
    from uniforce_vtla.tokenizer.calibrate import calibrate

    if config.pairs:
        grasps = recorded_grasps(
            config.pairs, config.new, config.anchor, config.tools, tokenizer, config.mounted
        )
    else:
        grasps = simulated_grasps(
            config.new, config.anchor, config.grasps, config.seed, tokenizer.pooled
        )
    return calibrate(
        grasps.new,
        grasps.anchor,
        grasps.classes,
        _head_of_anchor(config),
        config.new,
        config.anchor,
        config.fit,
        grasps.numbers,
    )


def weigh_sensor(config: CalibrateCommand, tokenizer: Tokenizer) -> Calibration:
    """Have loads pressed and fit the gain; raises as ``gain_of_loads`` and the presses do."""
    from uniforce_cli.known_loads import known_loads, simulated_presses, simulated_tool
    from uniforce_vtla.contact.worn_in_words import wear
    from uniforce_vtla.tokenizer.gains import gain_of_loads, gain_through_a_tool

    loads_N = known_loads(config.loads_N)
    head = _head_of_anchor(config)
    by_tool = config.through == "tool"
    simulate = simulated_tool if by_tool else simulated_presses
    if config.rig:
        latents, load_N = _presses_of_rig(config, loads_N, tokenizer)
    else:
        unit = wear(config.new)(config.seed)
        latents, load_N = simulate(unit, loads_N, config.seed, tokenizer.pooled)
    fit = gain_through_a_tool if by_tool else gain_of_loads
    return fit(latents, load_N, head, config.new, tokenizer.unmoved())


def _presses_of_rig(
    config: CalibrateCommand, loads_N: list[float], tokenizer: Tokenizer
) -> Presses:
    """Have a person press the loads on a sensor of the rig."""
    from lerobot.cameras.utils import make_cameras_from_configs

    from uniforce_cli.known_loads import finger_of, presses_by_hand

    wanted = finger_of(config.rig, config.finger)
    if wanted.sensor != _kind(config, config.new):
        raise ContractError(
            expected(f"new, as {config.rig} has it", wanted.sensor, config.new, "Name that sensor.")
        )
    wanted.reference_on_connect = True
    finger = cast("TactileFinger", make_cameras_from_configs({"finger": wanted})["finger"])
    print(f"{wanted.label}: taking the reference, keep it in free air")
    with finger:
        return presses_by_hand(finger, loads_N, tokenizer.pooled, config.through == "tool")


def _kind(config: CalibrateCommand, words: str) -> str:
    """Return the kind of sensor that some words name; raises SensorError: an unknown one."""
    from uniforce_vtla.contact.worn_in_words import wear

    return wear(words)(config.seed).kind


def _head_of_anchor(config: CalibrateCommand) -> ForceHead:
    from uniforce_vtla.tokenizer.force_head import ForceHead

    return ForceHead.from_pretrained(_kind(config, config.anchor), config.tokenizer or None)


def _check_sources(config: CalibrateCommand) -> None:
    """Refuse what contradicts itself before a tokenizer is loaded."""
    if config.pairs and config.loads_N:
        came = "pairs= and loads_N="
        do = "Leave one out."
        raise ContractError(expected("calibration", "pairs= or loads_N=", came, do))
    if config.mounted != "upright" and not config.pairs:
        do = "Give pairs=, or set rotation_deg and flip in the rig."
        raise ContractError(expected("mounted", "recorded pairs beside it", "none", do))
    if config.rig and not config.loads_N:
        do = "Give loads_N=3,6,9, or leave rig out: grasps are pairs=."
        raise ContractError(expected("rig", "known loads beside it", "none", do))
    if config.loads_N:
        refuse_unused(config, "loads_N=", ("task", "tools", "grasps", "fit"))
    elif config.pairs:
        refuse_unused(config, "pairs=", ("through", "finger", "grasps", "seed"))
    else:
        refuse_unused(config, "simulated grasps", ("through", "finger", "tools"))


def choice_in_words(choice: Choice) -> str:
    """Return the chosen form and the error that each form leaves on left-out grasps."""
    errors = f"none {choice.error['none']:.3f}, map {choice.error['map']:.3f}"
    noise = f"± {choice.standard_error['map']:.3f}"
    return f"chosen by {choice.grasps} left-out grasps: {choice.form}. Error: {errors} {noise}"


def check_agreement(found: Calibration, config: CalibrateCommand) -> str:
    """Return which class the task needs agrees least, in words.

    Raises ContractError: it agrees too little to be of use.
    """
    classes = OBJECT_CLASSES if config.task == "both" else (config.task,)
    name, r2 = found.worst(classes)
    if r2 < config.fit.refuse_below:
        do = (
            f"Grasp more {name} objects, from light to firm, all over the pad; "
            "or say task= if you need only others."
        )
        wanted = f"R² of Fz ≥ {config.fit.refuse_below} against the anchor"
        raise ContractError(expected(f"calibration on {name} objects", wanted, f"{r2:.2f}", do))
    return f"{name} objects agree least: R² of Fz {r2:.2f}"


def print_agreement(found: Calibration) -> None:
    """Print how well the force read from both fingers agrees, a line for each class of objects."""
    if found.choice:
        print(choice_in_words(found.choice))
    print(f"{found.new} against {found.anchor}, held-out grasps, R² (|r|) of the force read")
    for name, judged in found.agreement.items():
        axes = []
        for axis, r2, r in zip("xyz", judged.r2, judged.abs_r, strict=True):
            axes.append(f"F{axis} {r2:.2f} ({r:.2f})")
        before = " ".join(f"{r2:.2f}" for r2 in judged.r2_before)
        print(f"  {name:5} {', '.join(axes)}; before {before}; {judged.grasps} grasps")


@command(CalibrateCommand)
def main(config: CalibrateCommand) -> None:
    from uniforce_vtla.tokenizer.api import Tokenizer

    one_thread()
    _check_sources(config)
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    then = f"uniforce score policy=… right_sensor={config.new} right_calibration={config.out}"
    if config.loads_N:
        found = weigh_sensor(config, tokenizer)
        gain = f"gain of latents {found.latent_gain:.2f}"
        print(f"{config.new}: {gain}; in {found.save(config.out)}. Next: {then}")
        return
    found = calibrate_sensor(config, tokenizer)
    print_agreement(found)
    if abs(found.turn_deg) > TURN_DEG:
        logger.warning(
            "%s seems turned by %.0f°: see `uniforce touch check=angle`", config.new, found.turn_deg
        )
    worst = check_agreement(found, config)
    if found.worst()[1] < config.fit.warn_below:
        logger.warning("%s: grasp again, more of them and all over the pad", worst)
    print(f"{worst}; calibration in {found.save(config.out)}. Next: {then}")
