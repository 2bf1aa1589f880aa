"""Record equilibrium pairs: guide grasps of one indenter after the other until enough pairs are slow and balanced.

A frame is kept when the hand is slow (``gate``), the score finds it balanced (``pair_judge``), and its force cell is
not crowded yet (``coverage``). Kept pairs are saved chunk by chunk; a recorder started again goes on where the disk
stops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from uniforce_pair_recording.coverage import Coverage, contact_place
from uniforce_pair_recording.finger_force import FingerForce
from uniforce_pair_recording.gate import MotionLimits, quasi_static
from uniforce_pair_recording.pair_judge import JudgeSettings, PairJudge, PairQuality
from uniforce_pair_recording.rig import PairRig
from uniforce_pair_recording.storage import MIN_CHUNK, PairChunk, PairStore
from uniforce_pair_recording.track import FingerReader, GraspTrack
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected

KEPT = "kept"


@dataclass(frozen=True)
class RecordingPlan:
    """What to record.

    Attributes:
        pairs: per indenter.
        chunk: pairs saved at once; what a kill may cost.
        limits: what counts as slow.
        judge: numbers of the score.
        crowded: largest share of an indenter's pairs in one cell of force; more are left out.
        longest_grasp: frames after which a grasp is judged although the fingers hold on.
        give_up: frames per wanted pair after which an indenter is given up: something is wrong then.
        live_every: frames between two live scores.
    """

    pairs: int = 1000
    chunk: int = 50
    limits: MotionLimits = field(default_factory=MotionLimits)
    judge: JudgeSettings = field(default_factory=JudgeSettings)
    crowded: float = 0.25
    longest_grasp: int = 300
    give_up: int = 60
    live_every: int = 5


@dataclass(frozen=True)
class Status:
    """What an operator sees.

    Attributes:
        indenter, indenters: number of the current one, from 1, and of all.
        name: of the indenter.
        have, wanted: pairs.
        error: live score of the newest pair; NaN before there is one.
        reason: why the newest frame would not be kept; "" where it would.
        coverage: of this indenter.
    """

    indenter: int
    indenters: int
    name: str
    have: int
    wanted: int
    error: float
    reason: str
    coverage: Coverage


@dataclass
class SessionReport:
    """What became of the frames.

    Attributes:
        outcomes: how many frames were kept, or why not.
        kept: (grasp, frame within the grasp) of every kept pair, in order.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    kept: list[tuple[int, int]] = field(default_factory=list)


class PairRecorder:
    """One session: references are taken once, then grasps come in.

    Args:
        rig: delivers frames.
        store: keeps pairs.
        plan: what to record.
        tell: called with the live status.
    """

    def __init__(
        self, rig: PairRig, store: PairStore, plan: RecordingPlan, tell: Callable[[Status], None]
    ) -> None:
        self._rig, self._store, self._plan, self._tell = rig, store, plan, tell
        self._judge = PairJudge(plan.judge)
        self._session = store.next_session
        self.report = SessionReport()

    def run(self) -> SessionReport:
        """Record what is missing of every indenter.

        Raises:
            DatasetError: an indenter yields hardly any pairs, or the disk is full.
            SensorError, RobotError: from the rig; what was saved stays.
        """
        missing = [i for i, have in enumerate(self._store.counts) if have < self._plan.pairs]
        if not missing:
            return self.report
        self._references = self._rig.references()
        self._readers = {f: self._reader(f) for f in FINGERS}
        for indenter in missing:
            self._record(indenter)
        return self.report

    def _reader(self, finger: Finger) -> FingerReader:
        force = FingerForce.from_pretrained(self._rig.sensors[finger])
        return FingerReader(self._references[finger], finger, force)

    def _record(self, indenter: int) -> None:
        """Guide grasps of one indenter until enough is saved."""
        pairs = _Pairs(indenter, self._store, self._plan, self._session, self._references)
        track = GraspTrack(self._rig.mass_kg)
        for count, frame in enumerate(self._rig.frames(self._store.indenters[indenter]), 1):
            if track.frames and (frame.grasp != track.frames[0].grasp or self._is_long(track)):
                self._finish(track, pairs)
                track = GraspTrack(self._rig.mass_kg)
            if pairs.missing <= 0:
                return
            track.add(frame, self._readers)
            if count % self._plan.live_every == 0:
                self._tell(self._status(track, pairs))
            self._refuse_endless(count, pairs)

    def _is_long(self, track: GraspTrack) -> bool:
        return len(track.frames) >= self._plan.longest_grasp

    def _finish(self, track: GraspTrack, pairs: _Pairs) -> None:
        """Judge a whole grasp, keep what is good, learn from all of it."""
        signals = track.signals()
        quality = self._judge.judge(signals)
        self._judge.learn(signals)
        outcomes = pairs.take(track, quality, self._reasons(track, quality))
        self.report.outcomes.update(outcomes)
        number = track.frames[0].grasp
        self.report.kept += [(number, k) for k, outcome in enumerate(outcomes) if outcome == KEPT]
        self._tell(self._status(track, pairs))

    def _reasons(self, track: GraspTrack, quality: PairQuality) -> list[str]:
        """Why each frame would not be kept, "" where it would."""
        signals = track.signals()
        contact = np.maximum(signals.left_N[:, 2], signals.right_N[:, 2])
        gate = quasi_static(
            signals.velocity_m_s, signals.acceleration_m_s2, contact, self._rig.rate_hz, self._plan.limits
        )
        flags = zip(gate.reasons, quality.flagged, strict=True)
        return [reason or ("out of balance" if flagged else "") for reason, flagged in flags]

    def _status(self, track: GraspTrack, pairs: _Pairs) -> Status:
        quality = self._judge.judge(track.signals())
        return Status(
            pairs.indenter + 1,
            len(self._store.indenters),
            self._store.indenters[pairs.indenter],
            pairs.have,
            self._plan.pairs,
            float(quality.error[-1]),
            self._reasons(track, quality)[-1],
            self._store.coverage[pairs.indenter],
        )

    def _refuse_endless(self, frames: int, pairs: _Pairs) -> None:
        if frames < self._plan.longest_grasp + self._plan.give_up * self._plan.pairs:
            return
        why = ", ".join(f"{name} {count}" for name, count in self.report.outcomes.most_common(4))
        wanted = f"{self._plan.pairs} pairs of {self._store.indenters[pairs.indenter]}"
        do = "Hold the object from outside, lead slowly, take the references anew."
        raise DatasetError(expected("guided grasps", wanted, f"{pairs.have} in {frames} frames ({why})", do))


class _Pairs:
    """Good pairs of one indenter on their way to the store."""

    def __init__(
        self,
        indenter: int,
        store: PairStore,
        plan: RecordingPlan,
        session: int,
        references: dict[Finger, np.ndarray],
    ) -> None:
        self.indenter = indenter
        self._store, self._plan, self._session, self._references = store, plan, session, references
        self._waiting: list[tuple[GraspTrack, int, PairQuality, np.ndarray]] = []
        self._cells = store.coverage[indenter].force.copy()  # with those that wait

    @property
    def have(self) -> int:
        """Pairs saved or waiting."""
        return int(self._store.counts[self.indenter]) + len(self._waiting)

    @property
    def missing(self) -> int:
        """Pairs still wanted."""
        return self._plan.pairs - self.have

    def take(self, track: GraspTrack, quality: PairQuality, reasons: list[str]) -> list[str]:
        """Keep a grasp's good pairs, save full chunks; return what became of each frame."""
        place = contact_place(np.array(track.fields["left"]))
        outcomes = []
        for k, reason in enumerate(reasons):
            outcomes.append(reason or self._keep(track, k, quality, place))
            if self._is_due():
                self._save()
        return outcomes

    def _keep(self, track: GraspTrack, k: int, quality: PairQuality, place: np.ndarray) -> str:
        if self.missing <= 0:
            return "enough"
        cell = Coverage.cell((track.forces["left"][k] + track.forces["right"][k]) / 2)
        if self._cells[cell] >= max(1.0, self._plan.crowded * self._plan.pairs):
            return "crowded"
        self._cells[cell] += 1
        self._waiting.append((track, k, quality, place))
        return KEPT

    def _is_due(self) -> bool:
        """A full chunk, or the last one; the last but one leaves enough for a chunk behind."""
        waits, after = len(self._waiting), self.missing
        return waits >= MIN_CHUNK and (after <= 0 or (waits >= self._plan.chunk and after >= MIN_CHUNK))

    def _save(self) -> None:
        rows, self._waiting = self._waiting, []
        frames = [track.frames[k] for track, k, _, _ in rows]
        self._store.add(
            PairChunk(
                indenter=self.indenter,
                session=self._session,
                references=self._references,
                images={f: np.stack([frame.images[f] for frame in frames]) for f in FINGERS},
                force_N={f: np.array([track.forces[f][k] for track, k, _, _ in rows]) for f in FINGERS},
                place=np.array([place[k] for _, k, _, place in rows]),
                error=np.array([quality.error[k] for _, k, quality, _ in rows]),
                velocity_m_s=np.array([frame.velocity_m_s for frame in frames]),
                acceleration_m_s2=np.array([frame.acceleration_m_s2 for frame in frames]),
                grip_N=np.array([frame.grip_N for frame in frames]),
            )
        )
