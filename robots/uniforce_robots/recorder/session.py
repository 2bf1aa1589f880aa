"""Episodes until the dataset holds as many as wanted: wait, reference, record, judge, store."""

import itertools
import time
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from uniforce_robots.recorder.episode import ENDINGS, Ending, EpisodeLoop, Parts
from uniforce_robots.recorder.faults import StopRequestedError, cause_of
from uniforce_robots.recorder.operators import Command, Event, Phase
from uniforce_vtla import errors

MIN_FRAMES = 2  # of an aborted episode worth keeping: LeRobot stores no shorter one
ABORTS_IN_A_ROW = 3  # end an unattended session: a fault that comes back each time needs a person
RETRY_s = 0.1  # between two tries to begin, unattended
# exit codes
FAULT = 3
DISK_FULL = 4
INTERRUPTED = 130


@dataclass(frozen=True)
class SessionSettings:
    """Settings of a recording session."""

    # wanted in the dataset, those of earlier sessions included; aborted ones don't count
    episodes: int = 50
    # instructions, one per episode in turn; empty takes the rig's own
    prompts: tuple[str, ...] = ()
    episode_s: float = 60.0  # time limit
    drive_between: bool = True  # whether the teleoperator moves the robot between episodes
    unwell_s: float = 10.0  # how long an unattended session waits for sensors before it gives up
    keep_aborted: bool = True  # whether what was recorded until a fault is stored, labelled
    # of its ticks that an episode may miss; one that missed more is ``aborted:late``
    late_share: float = 0.1
    settings: dict[str, Any] = field(default_factory=dict)  # of the whole command, for the cards
    # of robot and teleoperator or of the scene, by dotted name; alike in all sessions of a dataset
    rig: dict[str, Any] = field(default_factory=dict)
    accept_changes: bool = False  # whether other settings than a dataset's own will do

    def __post_init__(self) -> None:
        if not 0 <= self.late_share <= 1:  # NaN is not, either
            wanted = "a share from 0 to 1"
            raise errors.ContractError(
                errors.expected("late_share", wanted, self.late_share, "Give one.")
            )


@dataclass(frozen=True)
class SessionEnd:
    """How a session ended."""

    # 0 all wanted episodes are there or the operator quit, or one of the constants above
    exit_code: int
    message: str  # why, in words
    endings: tuple[Ending, ...] = ()  # of every attempt of this session, in order


class _End(Exception):  # noqa: N818  the way out of nested phases
    def __init__(self, exit_code: int, message: str) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def _end(error: errors.UniForceError) -> _End:
    return _End(DISK_FULL if errors.no_room(error) else FAULT, str(error))


class RecordingSession:
    """Record with parts that are connected.

    ``judged`` episodes of the dataset count already; ``seed`` is the first attempt's and counts up.
    """

    def __init__(self, parts: Parts, settings: SessionSettings, judged: int, seed: int) -> None:
        self._parts = parts
        self._settings = settings
        self._judged = judged
        self._seed = seed
        self._fps = parts.rig.facts.fps
        self._is_attended = parts.operator.is_attended
        self._say = parts.view.say
        self._endings: list[Ending] = []
        self._quits = False
        self._is_off = False  # whether the teleoperator waits for a person's key, between episodes

    def run(self) -> SessionEnd:
        """Record what is missing."""
        code = 0
        at_once = False
        try:
            while self._judged < self._settings.episodes and not self._quits:
                at_once = self._attempt(at_once)
            message = f"{self._judged} of {self._settings.episodes} episodes"
        except StopRequestedError as error:
            code = INTERRUPTED
            message = str(error)
        except _End as end:
            code = end.exit_code
            message = str(end)
        return SessionEnd(code, message, tuple(self._endings))

    def _attempt(self, at_once: bool) -> bool:
        """Record one; return whether the next one shall begin at once."""
        if not at_once:
            self._wait_for_go()
        frames = round(self._settings.episode_s * self._fps)
        if self._quits or not self._prepare(frames):
            return False
        prompts = self._settings.prompts or (self._parts.rig.prompt,)
        prompt = prompts[self._judged % len(prompts)]
        if prompt is None:
            raise errors.ContractError(
                errors.expected("prompts", "an instruction", "none", "Give at least one.")
            )
        begun = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._parts.view.begin(f"episode {self._judged + 1}/{self._settings.episodes}: {prompt}")
        ending = self._judge(self._not_late(EpisodeLoop(self._parts, prompt, frames).run()))
        self._endings.append(ending)
        self._store(ending, {"begun": begun, "prompt": prompt})
        if ending.how != "rerecord":  # which begins the same scene again
            self._seed += 1
        self._after(ending)
        return ending.how == "rerecord"

    def _not_late(self, ending: Ending) -> Ending:
        """Return the ending, ``aborted:late`` where it would count but missed too many ticks."""
        ticks = ending.ticks
        allowed = self._settings.late_share
        if ending.how not in ("judged", "open") or ticks.late_share <= allowed:
            return ending
        do = "Free the computer, record fewer pixels, or set late_share."
        came = f"{ticks.missed} of {ticks.ticks + ticks.missed} missed"
        message = errors.expected("episode", f"at most {allowed:.0%} of its ticks missed", came, do)
        return replace(ending, how="aborted", cause="late", message=message)

    def _wait_for_go(self) -> None:
        if self._is_attended:
            number = f"{self._judged + 1}/{self._settings.episodes}"
            self._say(f"episode {number} is next: open the gripper; space begins, q ends")
        driving = False
        for events in self._parts.events(Phase.WAITING):
            if any(self._begins(event) for event in events):
                break
            driving = self._drive(driving)
        self._parts.rig.hold()

    def _begins(self, event: Event) -> bool:
        """Obey a command given between episodes; return whether the waiting is over."""
        self._quits = self._quits or event.command is Command.QUIT
        if event.command is Command.RECOVER:
            try:
                self._parts.rig.recover()
                self._say("recovered; nothing has moved")
            except errors.RobotError as error:
                self._say(f"not recovered: {error}")
        elif event.command is Command.HOLD:
            self._switch_off("held")
        elif event.command is Command.NOTE:
            self._say(f"a note belongs to an episode; not stored: {event.text}")
        self._is_off = self._is_off and event.command not in (Command.GO, Command.RECOVER)
        return event.command in (Command.GO, Command.QUIT)

    def _switch_off(self, why: str) -> None:
        """Hold, and steer no more until a person says so: nothing goes on by itself."""
        self._parts.rig.hold()
        self._is_off = True
        self._say(f"{why} (v clears it and steers again)")

    def _drive(self, driving: bool) -> bool:
        """Let a person move the robot between episodes; return whether it worked. Not a scene."""
        rig = self._parts.rig
        steering = self._parts.steering
        drives = self._settings.drive_between and self._is_attended and not rig.facts.simulated
        if self._is_off or not drives:
            return False
        try:
            axes = rig.axes()
            if not driving:
                steering.start_from(axes)
            rig.act(steering.target(axes))
        except errors.UniForceError as error:
            self._switch_off(str(error))
            return False
        return True

    def _prepare(self, frames: int) -> bool:
        """See to room and references; a refusal is said, and attended it means waiting again."""
        try:
            room = self._parts.disk.before_episode(frames, self._parts.recorder.total_frames)
        except errors.DatasetError as error:
            raise _end(error) from error
        self._say(f"the episode may take {room}")
        deadline_s = time.monotonic() + self._settings.unwell_s
        said = ""
        while True:
            self._parts.refuse_interrupted()
            try:
                self._parts.rig.begin_episode(self._seed)
                return True
            except errors.UniForceError as error:
                if str(error) != said:
                    said = str(error)
                    self._say(f"can't begin: {error}")
                if self._is_attended:
                    return False
                if isinstance(error, errors.RobotError) or time.monotonic() > deadline_s:
                    raise _End(FAULT, f"can't begin ({cause_of(error)}): {error}") from error
            time.sleep(RETRY_s)

    def _judge(self, ending: Ending) -> Ending:
        """Return the ending with an outcome: the rig's own verdict, else the operator's."""
        if ending.cause == "teleop" and self._parts.interrupts.count:
            # a terminal that hangs up takes its keys along
            return replace(ending, cause="interrupt")
        if ending.how not in ("open", "judged"):
            return ending
        verdict = self._parts.rig.verdict()
        if verdict is not None:
            return replace(ending, how="judged", outcome=verdict.outcome, clean=verdict.clean)
        if ending.how == "judged":
            return ending
        if self._is_attended:
            self._say("over: y success, f not wiped, g failed grasp, x discard, r re-record")
        try:
            for event in itertools.chain.from_iterable(self._parts.events(Phase.JUDGING)):
                if event.command is Command.NOTE:
                    ending = replace(ending, notes=(*ending.notes, event.text))
                elif event.command in ENDINGS:
                    return replace(ending, **ENDINGS[event.command])
        except StopRequestedError as error:
            ending = replace(ending, how="aborted", cause="interrupt", message=str(error))
        return ending

    def _store(self, ending: Ending, card: dict[str, Any]) -> None:
        recorder = self._parts.recorder
        frames = self._parts.recorder.num_frames
        keeps = ending.how == "judged" or (ending.how == "aborted" and self._settings.keep_aborted)
        try:
            if not keeps or frames < MIN_FRAMES:
                recorder.discard()
                self._say(f"not stored: {ending.label}")
                return
            card |= self._card(ending)
            recorder.save(
                ending.clean, ending.outcome, self._seed, ending.cause, card, self._settings.rig
            )
        # the latter: a row the storing process refused
        except (errors.DatasetError, errors.ContractError) as error:
            self._say(f"not stored: {error}")
            raise _end(error) from error
        self._judged += ending.how == "judged"
        counted = f"{self._judged}/{self._settings.episodes} episodes"
        self._say(f"stored {ending.label}, {frames / self._fps:.1f} s; {counted}")

    def _card(self, ending: Ending) -> dict[str, Any]:
        return {
            "label": ending.label,
            "message": ending.message,
            "notes": list(ending.notes),
            "pauses": ending.pauses,
            "held_s": round(ending.held_s, 4),
            "peak_force_N": round(self._parts.view.peak_N, 3),
            "ticks": ending.ticks.as_dict(),
            "teleop": self._parts.steering.name,
            "rig": self._parts.rig.facts.name,
            **self._parts.rig.summary(),
            "settings": self._settings.settings,
        }

    def _after(self, ending: Ending) -> None:
        """End the session where a person would have to look, and there is none."""
        self._quits = self._quits or ending.quits
        if ending.how != "aborted":
            return
        if ending.cause == "interrupt":
            raise StopRequestedError(ending.message)
        if ending.cause == "disk_full":
            raise _End(DISK_FULL, ending.message)
        said = f"{ending.label}: {ending.message}"
        of_robot = ending.cause.startswith("robot_")
        recent = [past.how for past in self._endings[-ABORTS_IN_A_ROW:]]
        if not self._is_attended and recent == ["aborted"] * ABORTS_IN_A_ROW:
            raise _End(FAULT, f"{ABORTS_IN_A_ROW} times in a row, {said}")
        if not self._is_attended and (of_robot or ending.cause in ("teleop", "storage", "other")):
            raise _End(FAULT, said)
        if self._is_attended:
            self._switch_off(said)
        else:
            self._say(said)
