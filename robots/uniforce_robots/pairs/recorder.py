"""Record equilibrium pairs: guide grasps of each indenter until enough are slow and balanced.

A frame is kept when the hand is slow (``gate``), the score finds it balanced (``pair_judge``), and
its bin of force is not crowded yet (``coverage``). Kept pairs are saved chunk by chunk; a recorder
started again goes on where the disk stops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Self

from uniforce_robots.pairs.coverage import Coverage
from uniforce_robots.pairs.pair_judge import PairJudge, PairQuality
from uniforce_robots.pairs.rig import PairRig
from uniforce_robots.pairs.storage import MIN_CHUNK, Pair, PairStore, Session
from uniforce_robots.pairs.track import FingerReaders, GraspTrack, MotionLimits
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected

KEPT = "kept"
LIVE_EVERY = 5  # frames between two live scores


@dataclass(frozen=True)
class RecordingPlan:
    """Pairs to record."""

    pairs: int = 1000  # per indenter
    chunk: int = 50  # pairs saved at once; what a kill may cost
    limits: MotionLimits = field(default_factory=MotionLimits)  # what counts as slow
    # largest share of an indenter's pairs in one cell of force; more are left out
    crowded: float = 0.25
    longest_grasp: int = 300  # frames after which a grasp is judged although the fingers hold on
    # frames per wanted pair after which an indenter is given up: something is wrong then
    give_up: int = 60


@dataclass(frozen=True)
class Status:
    """Display for the operator."""

    indenter: int  # number of the current one, from 1
    name: str  # of the indenter
    have: int  # pairs of it
    error: float  # live score of the newest pair
    reason: str  # why the newest frame would not be kept; "" where it would
    coverage: Coverage  # of this indenter


@dataclass
class SessionReport:
    """Counts of frames kept and left out."""

    outcomes: Counter[str] = field(default_factory=Counter)  # how many frames were kept, or why not
    # (grasp, frame within it) of every kept pair
    kept: list[tuple[int, int]] = field(default_factory=list)


class PairRecorder:
    """One session: references once, then grasps; ``show`` is called with the live status."""

    def __init__(
        self, rig: PairRig, store: PairStore, plan: RecordingPlan, show: Callable[[Status], None]
    ) -> None:
        self._rig = rig
        self._store = store
        self._plan = plan
        self._show = show
        self._judge = PairJudge()
        self._spent: int | None = None  # grasp that ended an indenter while it was still held
        self.report = SessionReport()

    def run(self) -> SessionReport:
        """Record what is missing of every indenter.

        Raises DatasetError: an indenter yields hardly any pairs, or the disk is full; SensorError,
        RobotError: from the rig; saved pairs stay.
        """
        missing = [i for i, have in enumerate(self._store.counts) if have < self._plan.pairs]
        if missing:
            session = Session(self._store.next_session, self._rig.references())
            readers = FingerReaders(self._rig, session.references)
            for indenter in missing:
                with _Pairs(indenter, self._store, self._plan, session) as pairs:
                    self._record(pairs, readers)
        return self.report

    def _record(self, pairs: _Pairs, readers: FingerReaders) -> None:
        """Guide grasps of one indenter until enough is saved."""
        track = GraspTrack(self._rig.mass_kg, readers)
        fruitless = 0  # frames since a pair was kept
        for count, frame in enumerate(self._rig.frames(pairs.name), 1):
            if frame.grasp == self._spent:
                continue
            is_long = len(track.frames) >= self._plan.longest_grasp
            if track.frames and (is_long or frame.grasp != track.frames[0].grasp):
                before = pairs.have
                self._finish(track, pairs)
                if pairs.have > before:
                    fruitless = 0
                if pairs.missing <= 0:
                    self._spent = track.frames[0].grasp
                    return
                track = GraspTrack(self._rig.mass_kg, readers)
            track.add(frame)
            if count % LIVE_EVERY == 0:
                self._show(self._status(track, pairs))
            fruitless += 1
            self._refuse_endless(fruitless, pairs)

    def _finish(self, track: GraspTrack, pairs: _Pairs) -> None:
        """Judge a whole grasp, keep what is good, learn from all of it."""
        quality = self._judge.judge(track.signals())
        self._judge.learn(track.signals())
        outcomes = pairs.take(track, quality, self._reasons(track, quality))
        self.report.outcomes.update(outcomes)
        for k, outcome in enumerate(outcomes):
            if outcome == KEPT:
                self.report.kept.append((track.frames[0].grasp, k))
        self._show(self._status(track, pairs))

    def _reasons(self, track: GraspTrack, quality: PairQuality) -> list[str]:
        """Return why each frame would not be kept, "" where it would."""
        gate = track.gate(self._rig.rate_hz, self._plan.limits).tolist()
        reasons = []
        for reason, flagged in zip(gate, quality.flagged, strict=True):
            if flagged and not reason:
                reason = "out of balance"
            reasons.append(reason)
        return reasons

    def _status(self, track: GraspTrack, pairs: _Pairs) -> Status:
        quality = self._judge.judge(track.signals())
        error = float(quality.error[-1])
        reason = self._reasons(track, quality)[-1]
        coverage = self._store.coverage[pairs.indenter]
        return Status(pairs.indenter + 1, pairs.name, pairs.have, error, reason, coverage)

    def _refuse_endless(self, frames: int, pairs: _Pairs) -> None:
        if frames < self._plan.longest_grasp + self._plan.give_up * self._plan.pairs:
            return
        why = ", ".join(f"{name} {count}" for name, count in self.report.outcomes.most_common(4))
        wanted = f"{self._plan.pairs} pairs of {pairs.name}"
        do = "Hold the object from outside, lead slowly, take the references anew."
        raise DatasetError(
            expected("guided grasps", wanted, f"none in {frames} frames ({why})", do)
        )


class _Pairs:
    """Good pairs of one indenter on their way to the store, which fills beside the recording.

    Saving takes about a second, and a robot that gets no target for that long holds. Whatever ends
    the recording, pairs that wait are saved.
    """

    def __init__(
        self, indenter: int, store: PairStore, plan: RecordingPlan, session: Session
    ) -> None:
        self.indenter = indenter
        self.name = store.indenters[indenter]
        self._store = store
        self._plan = plan
        self._session = session
        self._waiting: list[Pair] = []
        self._handed_over = int(store.counts[indenter])  # to the store, now or before
        self._cells = store.coverage[indenter].force.copy()  # with those that wait
        self._worker = ThreadPoolExecutor(1)
        self._saving: list[Future[None]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        with self._worker:
            if len(self._waiting) >= MIN_CHUNK:
                self._save()
            for saved in self._saving:
                saved.result()

    @property
    def have(self) -> int:
        """Pairs saved, being saved or waiting."""
        return self._handed_over + len(self._waiting)

    @property
    def missing(self) -> int:
        """Pairs still wanted; one that waits alone wants another, since a chunk has two."""
        waits = len(self._waiting)
        wanted = self._plan.pairs - self.have
        return max(wanted, MIN_CHUNK - waits) if waits else wanted

    def take(self, track: GraspTrack, quality: PairQuality, reasons: list[str]) -> list[str]:
        """Keep a grasp's good pairs, save full chunks; return what became of each frame."""
        outcomes = []
        for k, reason in enumerate(reasons):
            force_N = {f: track.forces[f][k] for f in FINGERS}
            pair = Pair(track.frames[k], force_N, float(quality.error[k]))
            outcomes.append(reason or self._keep(pair))
            if self._is_due():
                self._save()
        return outcomes

    def _keep(self, pair: Pair) -> str:
        if self.missing <= 0:
            return "enough"
        cell = Coverage.cell(pair.mean_force_N)
        if self._cells[cell] >= max(1.0, self._plan.crowded * self._plan.pairs):
            return "crowded"
        self._cells[cell] += 1
        self._waiting.append(pair)
        return KEPT

    def _is_due(self) -> bool:
        """Return whether a chunk is full or the last; enough pairs must be left for the last."""
        waits = len(self._waiting)
        after = self._plan.pairs - self.have
        return waits >= MIN_CHUNK and (
            after <= 0 or (waits >= self._plan.chunk and after >= MIN_CHUNK)
        )

    def _save(self) -> None:
        """Hand what waits to the store; raises as ``PairStore.add`` of an earlier chunk."""
        for saved in self._saving:
            if saved.done():
                saved.result()
        chunk = self._waiting
        self._waiting = []
        self._handed_over += len(chunk)
        saving = self._worker.submit(self._store.add, self.indenter, self._session, chunk)
        self._saving.append(saving)
