"""Label-free calibration: a sensor never pretrained on learns to give the known one's latents on the same grasps.

Both fingers grasp an externally held object for two minutes, half the time small objects, half the time tools. Their
forces are equal, so their latents should be. The difference depends on the place on the pad: one linear map of the
whole pooled latent, ridge-regressed towards the identity in closed form, is fitted to the pairs. No force is measured.
It corrects what a reference image can't show: stiffness, thickness and gain.

The map is used only if grasps that it wasn't fitted to are read better with it (``choose``). Otherwise one gain of the
newtons is, or nothing.

Who has a scale needs no known sensor: a few presses of known load give one gain of the newtons (``of_loads``), or, of
the tool that the fingers hold, one of shear (``through_a_tool``): a covered flat gel shows that and hardly grip.
Without a scale, wipe with the tool between a known finger and the new one (``beside_an_anchor``): each carries half
the press.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.calibration_choice import (
    GAINS,
    Choice,
    choose,
    fit_form,
    newtons,
    read_choice,
)
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent, own_latent
from uniforce_vtla.tokenizer.latent_map import LatentMap, grasp_numbers
from uniforce_vtla.tokenizer.mount_relation import SETTINGS, mount_relation
from uniforce_vtla.tokenizer.settings import OBJECT_CLASSES, CalibrationConfig
from uniforce_vtla.tokenizer.weights import content_hash, load_model, read_config, save_checkpoint

MAX_NUMBERS = 4096  # of a pooled latent; larger maps are none of ours
FEWEST_GRASPS = 3  # of a class: one judges, two choose
AXES = ("x", "y", "z")
FEWEST_LOADS = 3
REST_SHARE = 0.3  # of the mean load: what a gain may leave; simulated TacTips leave .05 to .1
# Of an axis on held-out grasps, from which on it is believed: grip under a tool has .93 to .99 for domes and taxels,
# .81 to .86 for flat gels.
TRUSTED_R2 = 0.9
HELD_N = 1.0  # of grip that the anchor reads, from which on both fingers hold the tool
FEWEST_HELD = 30  # moments
# of the anchor's shear; a tool that is only carried shows hardly more than noise
LEAST_SPREAD_N = 0.25
LEAST_R = 0.7  # between the fingers' shear
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Agreement:
    """Force read from the calibrated finger against the anchor's, held-out grasps of one class of objects."""

    grasps: int
    r2: tuple[float, float, float]  # x, y, z
    abs_r: tuple[float, float, float]
    r2_before: tuple[float, float, float]  # without the map


@dataclass(frozen=True)
class Calibration:
    """A fitted map or gain, the tokenizer and head it belongs to, and how well the fingers agree with it."""

    map: LatentMap
    tokenizer_hash: str  # whose latents it maps
    head_hash: str  # of the force head that judged it
    new: str
    anchor: str
    ridge: float  # chosen by cross-validation
    # that brings the new sensor's shear, as read before, to the anchor's; x towards y
    turn_deg: float
    agreement: dict[str, Agreement]  # by class of objects
    gain: float = 1.0  # of the newtons that the head reads after the map
    through_tool: bool = False  # whether the gain is of shear alone, found through a held tool
    choice: Choice | None = None  # of grasps; None: of loads or wipes, or older than the choice

    @classmethod
    def of_loads(
        cls, z: torch.Tensor, load_N: np.ndarray, head: ForceHead, new: str
    ) -> Calibration:
        """Return the gain that brings what ``head`` reads of presses (n, P, latent) to their known loads (n,) in N.

        The map is the identity. One gain serves all axes: a stiffer or duller pad answers less to any force.

        Raises ContractError: fewer than three loads, or readings that don't follow them by a gain that a pad explains.
        """
        known = np.asarray(load_N, float)
        read = head(z)[:, 2].double().numpy()  # type: ignore[arg-type]  # checks the origin
        if (
            len(known) != len(read)
            or len(set(known)) < FEWEST_LOADS
            or not (np.isfinite(known) & (known > 0)).all()
        ):
            came, do = f"{known.tolist()} for {len(read)} frames", "Press with 3, 6 and 9 N."
            raise ContractError(
                expected("loads", f"{FEWEST_LOADS} or more different ones, one a frame", came, do)
            )
        do = "Are loads in newtons, and is the reference of free air? A covered flat gel is weighed with through=tool."
        return cls._weighed(z, head, new, _gain(known, read, do))

    @classmethod
    def through_a_tool(
        cls, z: torch.Tensor, load_N: np.ndarray, head: ForceHead, new: str
    ) -> Calibration:
        """Return the gain of shear of a finger that holds a tool, pressed down on a scale with known loads.

        Half of a load comes up through each finger. The grip isn't weighed: a policy holds it (touch/grip.py).

        Args:
            z: (n, P, latent) of presses, and of the tool hanging free, load 0.
            load_N: (n,) what the scale shows, N.
            head: of the kind whose newtons the policy knows.
            new: the sensor, in words.

        Raises ContractError: fewer than three loads, none of a hanging tool, or readings that don't follow them.
        """
        known = np.asarray(load_N, float)
        shear = head(z)[:, 1].double().numpy()  # type: ignore[arg-type]  # canonical y points down
        is_free = known == 0
        loads = set(known[~is_free])
        fits = (
            len(known) == len(shear) and bool(np.isfinite(known).all()) and bool((known >= 0).all())
        )
        if not fits or not is_free.any() or len(loads) < FEWEST_LOADS:
            came, do = (
                f"{known.tolist()} for {len(shear)} frames",
                "Let it hang free, then press with 3, 6 and 9 N.",
            )
            raise ContractError(
                expected("loads", f"0 and {FEWEST_LOADS} or more different ones", came, do)
            )
        carried_N = known[~is_free] / 2
        read_N = shear[is_free].mean() - shear[~is_free]  # a press pushes the tool up
        do = "Is the reference of free air, and do tool and sensor stand upright?"
        return cls._weighed(z, head, new, _gain(carried_N, read_N, do), through_tool=True)

    @classmethod
    def beside_an_anchor(
        cls, z_new: torch.Tensor, z_anchor: torch.Tensor, head: ForceHead, new: str, anchor: str
    ) -> Calibration:
        """Fit one shear gain to wipes in which a known finger holds the tool on the other side.

        Each finger carries half of the press, so no force label is needed. The grip isn't scaled.

        Args:
            z_new: (n, P, latent) of the sensor to scale, moments of wiping in any order.
            z_anchor: (n, P, latent) of the known one at the same moments.
            head: of the kind whose newtons the policy knows.
            new: the sensor to scale, in words.
            anchor: the known one, in words.

        Raises ContractError: latents that aren't paired, too few moments in which the tool is held, or shear that
        hardly changes or that the fingers disagree about.
        """
        if z_new.shape != z_anchor.shape:
            came = f"{tuple(z_new.shape)} and {tuple(z_anchor.shape)}"
            raise ContractError(
                expected("paired latents", "(n, P, latent) twice", came, "Pair them by frame.")
            )
        read, known = head(z_new).double().numpy(), head(z_anchor).double().numpy()  # type: ignore[arg-type]
        is_held = known[:, 2] > HELD_N
        gain = shear_gain(read[is_held, 1], known[is_held, 1])
        return cls._weighed(z_new, head, new, gain, through_tool=True, anchor=anchor)

    @classmethod
    def _weighed(
        cls,
        z: torch.Tensor,
        head: ForceHead,
        new: str,
        gain: float,
        through_tool: bool = False,
        anchor: str = "",
    ) -> Calibration:
        """Return a gain alone: its map is the identity."""
        same = LatentMap(*z.shape[1:]).eval()
        return cls(
            same,
            head.tokenizer_hash,
            head.hash,
            new,
            anchor or new,
            0.0,
            0.0,
            {},
            gain,
            through_tool,
        )

    def scaled(self, force_N: torch.Tensor) -> torch.Tensor:
        """Return newtons (…, 3), read after the map, by the gain: of all axes, or of shear where a tool was weighed."""
        if not self.through_tool:
            return force_N * self.gain
        return force_N * force_N.new_tensor([self.gain, self.gain, 1.0])

    @torch.no_grad()
    def __call__(self, z: Latent) -> Latent:
        """Return the pooled latents (B, P, latent) the anchor would have given; raises as ``ForceHead`` does."""
        own = own_latent(z, self.tokenizer_hash, f"the calibration of {self.new}")
        wanted, came = len(self.map.centre), own[0].numel() if len(own) else 0
        if own.ndim != 3 or came != wanted:
            do = "Pool them as the calibration's were: pool_latent(z)."
            raise ContractError(
                expected("latents to calibrate", f"(B, P, L) of {wanted}", tuple(z.shape), do)
            )
        return Latent.of(self.map(own), self.tokenizer_hash)

    @property
    def hash(self) -> str:
        """Content hash of map, gain and what they belong to; a policy that wears it stores this."""
        gain: dict[str, object] = {} if self.gain == 1 else {"gain": self.gain}
        gain |= {"through_tool": True} if self.through_tool else {}
        return content_hash(self.map, {"tokenizer_hash": self.tokenizer_hash, **gain})

    @property
    def reads_grip(self) -> bool:
        """Whether a sensor so calibrated reads grip under a tool; a gain of bare presses was never judged: yes."""
        if self.through_tool:
            return False
        return "tool" not in self.agreement or self.agreement["tool"].r2[2] >= TRUSTED_R2

    @property
    def grip_in_words(self) -> str:
        """How well grip is read under a tool."""
        if self.through_tool:
            return f"the gain of {self.new} is of shear alone, which says nothing of grip"
        return f"the calibration of {self.new} reads grip under tools with R² {self.agreement['tool'].r2[2]:.2f}"

    def worst(self, classes: Sequence[str] = OBJECT_CLASSES) -> tuple[str, float]:
        """Return the class and R² of Fz that agrees least among ``classes``."""
        return min(
            ((name, self.agreement[name].r2[2]) for name in classes), key=lambda found: found[1]
        )

    def facts(self) -> dict[str, object]:
        """Return which sensors it matches, and how well."""
        judged = {name: asdict(found) for name, found in self.agreement.items()}
        numbers: dict[str, object] = {
            "ridge": self.ridge,
            "turn_deg": self.turn_deg,
            "gain": self.gain,
        }
        numbers |= {"through_tool": True} if self.through_tool else {}
        numbers |= {"choice": asdict(self.choice)} if self.choice else {}
        return {"new": self.new, "anchor": self.anchor, **numbers, "agreement": judged}

    def save(self, path: str | Path) -> Path:
        """Write the map and its facts to a folder ``load`` reads."""
        sizes = {"patches": self.map.patches, "latent": self.map.latent}
        hashes = {"tokenizer_hash": self.tokenizer_hash, "head_hash": self.head_hash}
        return save_checkpoint(Path(path), self.map, self.facts() | sizes | hashes)

    @classmethod
    def load(cls, path: str | Path, tokenizer_hash: str) -> Calibration:
        """Load a calibration made for the tokenizer with this hash.

        Raises CheckpointError: damaged, or made for another tokenizer.
        """
        folder = Path(path)
        facts = read_config(folder)
        if (came := facts.get("tokenizer_hash")) != tokenizer_hash:
            do = "Calibrate again with this tokenizer."
            raise CheckpointError(expected(f"tokenizer of {folder}", tokenizer_hash, came, do))
        try:
            patches, latent = (
                check_count(name, facts[name], MAX_NUMBERS) for name in ("patches", "latent")
            )
            check_count("numbers", patches * latent, MAX_NUMBERS)
            texts = str(facts["head_hash"]), str(facts["new"]), str(facts["anchor"])
            ridge, turn, gain = (
                float(facts["ridge"]),
                float(facts["turn_deg"]),
                float(facts.get("gain", 1.0)),
            )
            if not GAINS[0] <= gain <= GAINS[1]:
                raise ValueError(f"gain {gain}")
            through_tool = facts.get("through_tool", False) is True
            agreement = {name: _agreement(found) for name, found in facts["agreement"].items()}
            choice = read_choice(facts["choice"]) if "choice" in facts else None
        except (KeyError, TypeError, ValueError, AttributeError, ContractError) as error:
            wanted, do = "the facts of a calibration", "Calibrate again."
            raise CheckpointError(expected(f"config of {folder}", wanted, error, do)) from error
        found = load_model(folder, lambda: LatentMap(patches, latent))
        return cls(
            found.eval(), tokenizer_hash, *texts, ridge, turn, agreement, gain, through_tool, choice
        )


def calibrate(
    z_new: torch.Tensor,
    z_anchor: torch.Tensor,
    classes: Sequence[str],
    head: ForceHead,
    new: str,
    anchor: str,
    config: CalibrationConfig | None = None,
    grasps: Sequence[int] | None = None,
) -> Calibration:
    """Choose and fit a map, a gain or nothing to paired pooled latents, and judge it on grasps that had no part in it.

    Args:
        z_new: (n, P, latent) of the sensor to calibrate, canonical frame.
        z_anchor: (n, P, latent) of the known sensor on the other finger.
        classes: (n) what was grasped: "small" or "tool".
        head: force head of the anchor; it reads both fingers for the judgement, the fit doesn't need it.
        new: name of the sensor to calibrate.
        anchor: name of the known one.
        config: share held out, fewest pairs, seed.
        grasps: (n) number of the grasp that a row is of; None where each row is a grasp of its own.

    Raises ContractError: too few pairs or grasps of a class, different shapes, NaN, no origin, grasps that never load
    the sensors, or a sensor mounted turned by 180° or mirrored; CheckpointError: latents of another tokenizer than the
    head's.
    """
    config = config or CalibrationConfig()
    origin = head.tokenizer_hash
    own_new, own_anchor = (own_latent(z, origin, "calibration") for z in (z_new, z_anchor))
    names = np.asarray(classes)
    of_grasp = grasp_numbers(grasps, len(names))
    _check(own_new, own_anchor, names, of_grasp, config)
    judge, fit = _split(names, of_grasp, config)
    paired = own_new[fit], own_anchor[fit], head, of_grasp[fit]
    choice = choose(*paired, with_gain=config.gain)
    found = fit_form(choice.form, *paired)
    truth, before = newtons(head, own_anchor[judge]), newtons(head, own_new[judge])
    _refuse_other_mount(before[:, :2], truth[:, :2], new, anchor)
    after = found.newtons(head, own_new[judge])
    judged = {}
    for kind in OBJECT_CLASSES:
        of_kind = names[judge] == kind
        t, a, b = (values[of_kind] for values in (truth, after, before))
        judged[kind] = Agreement(
            len(np.unique(of_grasp[judge][of_kind])), _r2(t, a), _abs_r(t, a), _r2(t, b)
        )
    turn_deg = float(np.degrees(in_plane_turn_rad(before[:, :2], truth[:, :2])))
    fitted = found.map, origin, head.hash, new, anchor, found.ridge
    return Calibration(*fitted, turn_deg, judged, found.gain, choice=choice)


def _refuse_other_mount(read: np.ndarray, known: np.ndarray, new: str, anchor: str) -> None:
    """Raise ContractError where (n, 2) shear shows that one of two sensors is turned by 180° or mirrored.

    A map would learn that, too, and the rig would still show the sensor the wrong way round.
    """
    relation = mount_relation(read, known)
    x, y = relation.r
    if relation.mount == "undecided":
        logger.warning(
            "%s: shear agrees too little to tell how it is mounted (r %.2f along x, %.2f along y)",
            new,
            x,
            y,
        )
    elif relation.mount != "upright":
        rotation_deg, flip = SETTINGS[relation.mount]
        came = f"the one {relation.mount} against the other (r of shear {x:.2f} along x, {y:.2f} along y)"
        do = (
            f"`uniforce touch check=orientation` says which. If it is {new}: rotation_deg={rotation_deg}"
            f"{' flip=true' if flip else ''} in the rig{' (a camera: its driver mirrors)' if flip else ''}; "
            f"for pairs recorded without, mounted={relation.mount}."
        )
        raise ContractError(expected(f"mounts of {new} and {anchor}", "both upright", came, do))


def in_plane_turn_rad(read: np.ndarray, known: np.ndarray) -> float:
    """Return the turn, x towards y, that brings (n, 2) readings closest to (n, 2) known vectors (Procrustes)."""
    a, b = (v - v.mean(axis=0) for v in (read, known))
    return float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))


def _split(
    classes: np.ndarray, grasps: np.ndarray, config: CalibrationConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows that judge, the same share of each class's grasps, and rows that are fitted to, in random order."""
    order = np.random.default_rng(config.seed).permutation(len(classes))
    judges: list[int] = []
    for name in OBJECT_CLASSES:
        own = list(dict.fromkeys(grasps[order][classes[order] == name].tolist()))
        judges += own[: math.ceil(config.held_out * len(own))]
    is_judge = np.isin(grasps[order], judges)
    return order[is_judge], order[~is_judge]


def shear_gain(read_N: np.ndarray, known_N: np.ndarray) -> float:
    """Return the ratio of spreads: of the anchor's shear (n,) in N over the new finger's, (n,) as read.

    Both readings are noisy. A regression would shrink the gain by the noise of the new finger (regression dilution).

    Raises ContractError: too few frames, shear that hardly changes, or fingers that disagree.
    """
    do = "Grasp the tool with both fingers and wipe, pressing lightly and firmly."
    if len(known_N) < FEWEST_HELD:
        came = f"{len(known_N)} in which the anchor feels more than {HELD_N} N"
        raise ContractError(expected("moments of wiping", f"at least {FEWEST_HELD}", came, do))
    known_sd_N, read_sd_N = known_N.std(), max(float(read_N.std()), 1e-9)
    if known_sd_N < LEAST_SPREAD_N:
        wanted, came = f"{LEAST_SPREAD_N} N of spread or more", f"{known_sd_N:.2f} N"
        raise ContractError(expected("shear of the anchor", wanted, came, do))
    r = float(
        ((known_N - known_N.mean()) * (read_N - read_N.mean())).mean() / (known_sd_N * read_sd_N)
    )
    gain = float(known_sd_N / read_sd_N)
    if r < LEAST_R or not GAINS[0] <= gain <= GAINS[1]:
        wanted = (
            f"one that follows the anchor's, r ≥ {LEAST_R}, by a gain of {GAINS[0]} to {GAINS[1]}"
        )
        came = f"r {r:.2f}, gain {gain:.2f}"
        raise ContractError(
            expected("shear of the new sensor", wanted, came, "Are both sensors mounted upright?")
        )
    return gain


def _gain(known_N: np.ndarray, read_N: np.ndarray, do: str) -> float:
    """Return the gain that brings readings (n,) to known loads (n,); ContractError: they don't follow them."""
    gain = float((known_N * read_N).sum() / max(float((read_N**2).sum()), 1e-9))
    rest_N = float(np.sqrt(((gain * read_N - known_N) ** 2).mean()))
    if not GAINS[0] <= gain <= GAINS[1] or rest_N > REST_SHARE * known_N.mean():
        came = f"{np.round(read_N, 1).tolist()} N read of {known_N.tolist()}"
        wanted = f"readings that follow the loads, by a gain of {GAINS[0]} to {GAINS[1]}"
        raise ContractError(expected("presses", wanted, came, do))
    return gain


def _r2(truth: np.ndarray, read: np.ndarray) -> tuple[float, float, float]:
    spread = np.maximum(((truth - truth.mean(axis=0)) ** 2).sum(axis=0), 1e-12)
    x, y, z = (1 - ((read - truth) ** 2).sum(axis=0) / spread).tolist()
    return x, y, z


def _abs_r(truth: np.ndarray, read: np.ndarray) -> tuple[float, float, float]:
    a, b = truth - truth.mean(axis=0), read - read.mean(axis=0)
    length = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    x, y, z = np.abs((a * b).sum(axis=0) / np.maximum(length, 1e-12)).tolist()
    return x, y, z


def _agreement(stored: dict[str, object]) -> Agreement:
    r2, abs_r, before = ([float(v) for v in stored[name]] for name in ("r2", "abs_r", "r2_before"))  # type: ignore[attr-defined]
    return Agreement(int(stored["grasps"]), (*r2,), (*abs_r,), (*before,))  # type: ignore[call-overload,arg-type]


def _check(
    z_new: torch.Tensor,
    z_anchor: torch.Tensor,
    classes: np.ndarray,
    grasps: np.ndarray,
    config: CalibrationConfig,
) -> None:
    if (
        z_new.shape != z_anchor.shape
        or z_new.ndim != 3
        or not len(classes) == len(grasps) == len(z_new)
    ):
        came = f"{tuple(z_new.shape)}, {tuple(z_anchor.shape)}, {len(classes)} classes and {len(grasps)} grasps"
        wanted = "(n, P, latent) twice, n classes, n grasps"
        raise ContractError(expected("paired latents", wanted, came, "Pair them by frame."))
    if unknown := set(classes.tolist()) - set(OBJECT_CLASSES):
        raise ContractError(
            expected(
                "class of an object", " | ".join(OBJECT_CLASSES), sorted(unknown), "Name it so."
            )
        )
    for name in OBJECT_CLASSES:
        if (count := int((classes == name).sum())) < config.min_pairs // 2:
            do = f"Grasp one class for a minute, then the other: {name} objects are missing."
            raise ContractError(
                expected(
                    f"grasps of {name} objects", f"at least {config.min_pairs // 2}", count, do
                )
            )
        if (apart := len(np.unique(grasps[classes == name]))) < FEWEST_GRASPS:
            do = "Open the fingers between grasps, and grasp more often."
            raise ContractError(
                expected(
                    f"separate grasps of {name} objects", f"at least {FEWEST_GRASPS}", apart, do
                )
            )
    if not bool(z_new.isfinite().all() and z_anchor.isfinite().all()):
        raise ContractError(
            expected("latents", "finite numbers", "NaN or inf", "Check the recordings.")
        )
    if float(z_anchor.mean(dim=1).std(dim=0).max()) < 1e-6:
        do = "Hold the object from outside and squeeze, push and twist it."
        raise ContractError(expected("grasps", "changing forces", "the same latent throughout", do))
