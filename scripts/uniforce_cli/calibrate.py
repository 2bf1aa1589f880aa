"""Calibrate a new sensor: by grasps or wipes beside a known one, or by presses of known load."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal, cast

from uniforce_cli.boundary import command, one_thread
from uniforce_cli.paired_grasps import (
    recorded_grasps,
    recorded_wipes,
    simulated_grasps,
)
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
    from uniforce_robots.sensors.finger import TactileFinger
    from uniforce_vtla.tokenizer.api import Tokenizer
    from uniforce_vtla.tokenizer.calibration import Calibration
    from uniforce_vtla.tokenizer.calibration_choice import Choice

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
    """Fit the sensor ``new`` to paired grasps with the sensor ``anchor``, or one gain of it to known loads.

    Left-out grasps choose among a map of the latent, one gain of the newtons and none.

    Two minutes: hold a small object from outside, let both fingers grasp it, squeeze, push and twist; after a minute
    take a tool's flat handle. Record that with: uniforce pairs robot=franka rig=rig.yaml indenters=small,tool
    Example: uniforce calibrate new=gelsight anchor=tactip pairs=outputs/pairs/uniforce_pairs out=outputs/calibration
    In simulation: uniforce calibrate new=gelsight_stiff anchor=tactip, or a unit of them: new=tactip:7 anchor=tactip:1
    With a kitchen scale, half a minute, the fingers holding the task's tool:
    uniforce calibrate new=uskin rig=rig.yaml finger=right loads_N=3,6,9 through=tool
    Its simulation: uniforce calibrate new=uskin:7 loads_N=3,6,9 through=tool. A gain is all it fits.
    Without a scale, from a few recorded wipes with a known sensor on the other finger, one gain of shear:
    uniforce calibrate new=uskin anchor=tactip wipes=outputs/wiping finger=right
    Use it: uniforce score … right_sensor=uskin right_calibration=outputs/calibration
    """

    # the sensor to fit; in simulation unit 1 of it, or uskin:7 | uskin:drawing | with a fault tactip:1+gain=1.6
    new: Unit = "gelsight_stiff"
    anchor: Unit = "tactip"  # the known sensor, in the same words; its force head reads both
    # recorded pairs, as `uniforce pairs` writes them; empty = grasps are simulated
    pairs: FolderPath = ""
    # how new sat on its finger while pairs were recorded; the rig's rotation_deg and flip bring it upright from then on
    mounted: Literal["upright", "turned", "mirrored_x", "mirrored_y"] = "upright"
    tools: Text = "tool,flat"  # recorded objects that count as tools; all others are small
    # which objects must agree, or the calibration is refused
    task: Literal["both", "small", "tool"] = "both"
    grasps: Count = 600  # simulated pairs
    loads_N: Numbers = ""  # known loads instead of an anchor's grasps, three or more
    # loads_N: pad, pressed bare on a handle: one gain of all axes, of domes and taxels | tool, pressed on the scale by
    # the fingers that hold it: one gain of the shear that a task feels, for every kind
    through: Literal["pad", "tool"] = "pad"
    # loads_N: YAML file with `robot: {cameras: …}`; empty = presses are simulated
    rig: FilePath = ""
    # a dataset of `uniforce record` whose fingers wear new and anchor, instead of grasps
    wipes: FolderPath = ""
    finger: Literal["left", "right"] = "right"  # that wears new: of the rig, or in recorded wipes
    out: OutFolder = "outputs/calibration"  # the map's folder
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    # what judges, and what is refused
    fit: CalibrationConfig = field(default_factory=CalibrationConfig)
    seed: Seed = 0  # of the grasps


def calibrate_sensor(config: CalibrateCommand, tokenizer: Tokenizer) -> Calibration:
    """Gather grasps and fit; raises as ``calibrate``, SensorError for an unknown sensor, DatasetError for bad pairs."""
    from uniforce_vtla.contact.worn_in_words import wear
    from uniforce_vtla.tokenizer.calibration import calibrate
    from uniforce_vtla.tokenizer.force_head import ForceHead

    _, anchor_kind = (wear(words)(config.seed).kind for words in (config.new, config.anchor))
    sensors = config.new, config.anchor
    if config.pairs:
        grasps = recorded_grasps(config.pairs, *sensors, config.tools, tokenizer, config.mounted)
    else:
        grasps = simulated_grasps(*sensors, config.grasps, config.seed, tokenizer.pooled)
    head = ForceHead.from_pretrained(anchor_kind, config.tokenizer or None)
    names = config.new, config.anchor
    return calibrate(
        grasps.new, grasps.anchor, grasps.classes, head, *names, config.fit, grasps.numbers
    )


def scale_sensor(config: CalibrateCommand, tokenizer: Tokenizer) -> Calibration:
    """Fit the gain of shear to recorded wipes; raises as ``Calibration.beside_an_anchor`` and ``recorded_wipes``."""
    from uniforce_vtla.contact.worn_in_words import wear
    from uniforce_vtla.tokenizer.calibration import Calibration
    from uniforce_vtla.tokenizer.force_head import ForceHead

    kinds = {words: wear(words)(config.seed).kind for words in (config.new, config.anchor)}
    of_new, of_anchor = recorded_wipes(
        config.wipes, kinds[config.new], kinds[config.anchor], config.finger, tokenizer
    )
    head = ForceHead.from_pretrained(kinds[config.anchor], config.tokenizer or None)
    return Calibration.beside_an_anchor(of_new, of_anchor, head, config.new, config.anchor)


def weigh_sensor(config: CalibrateCommand, tokenizer: Tokenizer) -> Calibration:
    """Have loads pressed and fit the gain; raises as ``Calibration.of_loads`` and the presses do."""
    from uniforce_cli.known_loads import (
        finger_of,
        known_loads,
        presses_by_hand,
        simulated_presses,
        simulated_tool,
    )
    from uniforce_vtla.contact.worn_in_words import wear
    from uniforce_vtla.tokenizer.calibration import Calibration
    from uniforce_vtla.tokenizer.force_head import ForceHead

    loads_N = known_loads(config.loads_N)
    worn, anchor = (wear(words)(config.seed) for words in (config.new, config.anchor))
    head = ForceHead.from_pretrained(anchor.kind, config.tokenizer or None)
    encode = tokenizer.pooled
    by_tool = config.through == "tool"
    fit = Calibration.through_a_tool if by_tool else Calibration.of_loads
    if not config.rig:
        press = simulated_tool if by_tool else simulated_presses
        return fit(*press(worn, loads_N, config.seed, encode), head, config.new)
    from lerobot.cameras.utils import make_cameras_from_configs

    wanted = finger_of(config.rig, config.finger)
    if wanted.sensor != worn.kind:
        raise ContractError(
            expected(f"new, as {config.rig} has it", wanted.sensor, config.new, "Name that sensor.")
        )
    wanted.reference_on_connect = True
    finger = cast("TactileFinger", make_cameras_from_configs({"finger": wanted})["finger"])
    print(f"{wanted.label}: taking the reference, keep it in free air")
    with finger:
        return fit(*presses_by_hand(finger, loads_N, encode, by_tool), head, config.new)


def _check_sources(config: CalibrateCommand) -> None:
    """Refuse what contradicts itself before a tokenizer is loaded."""
    named = {"pairs=": config.pairs, "wipes=": config.wipes, "loads_N=": config.loads_N}
    given = [name for name, value in named.items() if value]
    if len(given) > 1:
        came = " and ".join(given)
        raise ContractError(
            expected("calibration", "pairs=, wipes= or loads_N=", came, "Leave all but one out.")
        )
    if config.mounted != "upright" and not config.pairs:
        do = "Give pairs=, or set rotation_deg and flip in the rig."
        raise ContractError(expected("mounted", "recorded pairs beside it", "none", do))
    if config.rig and not config.loads_N:
        do = "Give loads_N=3,6,9, or leave rig out: recorded grasps are pairs=, recorded wipes wipes=."
        raise ContractError(expected("rig", "known loads beside it", "none", do))


def choice_in_words(choice: Choice) -> str:
    """Return the chosen form and the error that each form leaves on left-out grasps."""
    errors = ", ".join(f"{form} {error:.3f}" for form, error in choice.error.items())
    noise = ", ".join(f"{form} ± {choice.standard_error[form]:.3f}" for form in ("gain", "map"))
    return f"chosen by {choice.grasps} left-out grasps: {choice.form}. Error: {errors}; against none {noise}"


def check_agreement(found: Calibration, config: CalibrateCommand) -> str:
    """Return which class the task needs agrees least, in words; ContractError: it agrees too little to be of use."""
    classes = OBJECT_CLASSES if config.task == "both" else (config.task,)
    name, r2 = found.worst(classes)
    if r2 < config.fit.refuse_below:
        do = f"Grasp more {name} objects, from light to firm, all over the pad; or say task= if you need only others."
        wanted = f"R² of Fz ≥ {config.fit.refuse_below} against the anchor"
        raise ContractError(expected(f"calibration on {name} objects", wanted, f"{r2:.2f}", do))
    return f"{name} objects agree least: R² of Fz {r2:.2f}"


@command(CalibrateCommand)
def main(config: CalibrateCommand) -> None:
    from uniforce_vtla.tokenizer.api import Tokenizer
    from uniforce_vtla.tokenizer.calibration import AXES

    one_thread()
    _check_sources(config)
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    then = f"uniforce score policy=… right_sensor={config.new} right_calibration={config.out}"
    if config.loads_N or config.wipes:
        found = (
            weigh_sensor(config, tokenizer) if config.loads_N else scale_sensor(config, tokenizer)
        )
        what = "gain of shear" if found.through_tool else "gain"
        print(f"{config.new}: {what} {found.gain:.2f}; in {found.save(config.out)}. Next: {then}")
        return
    found = calibrate_sensor(config, tokenizer)
    if found.choice:
        print(choice_in_words(found.choice))
    print(f"{config.new} against {config.anchor}, held-out grasps, R² (|r|) of the force read")
    for name, judged in found.agreement.items():
        axes = [
            f"F{a} {r2:.2f} ({r:.2f})"
            for a, r2, r in zip(AXES, judged.r2, judged.abs_r, strict=True)
        ]
        before = " ".join(f"{r2:.2f}" for r2 in judged.r2_before)
        print(f"  {name:5} {', '.join(axes)}; before {before}; {judged.grasps} grasps")
    if abs(found.turn_deg) > TURN_DEG:
        logger.warning(
            "%s seems turned by %.0f°: see `uniforce touch check=angle`", config.new, found.turn_deg
        )
    worst = check_agreement(found, config)
    if not found.reads_grip:
        print(
            f"{found.grip_in_words}: a policy holds it from the lift on (grip=read | held says otherwise)"
        )
    if found.worst()[1] < config.fit.warn_below:
        logger.warning("%s: grasp again, more of them and all over the pad", worst)
    print(f"{worst}; calibration in {found.save(config.out)}. Next: {then}")
