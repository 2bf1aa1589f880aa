"""Who says how an episode went: the scene where it knows, else the operator, during it or after it."""

from __future__ import annotations

from dataclasses import replace

from uniforce_recording.ending import Ending
from uniforce_recording.episode_loop import Parts
from uniforce_recording.operators import VERDICTS, Command, Event, Phase
from uniforce_recording.ticker import Ticker


def judge(parts: Parts, ending: Ending) -> Ending:
    """Return the ending with an outcome: the rig's where it knows better than a person, else the operator's."""
    if ending.how not in ("open", "judged"):
        return ending
    verdict = parts.rig.verdict()
    if verdict is not None:
        return replace(ending, how="judged", outcome=verdict.outcome, clean=verdict.clean)
    return ending if ending.how == "judged" else _ask(parts, ending)


def _ask(parts: Parts, ending: Ending) -> Ending:
    """Wait for a word; Ctrl-C is one too."""
    if parts.operator.is_attended:
        parts.view.say("over: y success, f not wiped, g failed grasp, x discard, r re-record")
    beat, notes = Ticker(parts.rig.facts.fps), list(ending.notes)
    while not parts.interrupts.count:
        for event in parts.operator.poll(Phase.JUDGING):
            if event.command is Command.NOTE:
                notes.append(event.text)
            elif (judged := _judgement(ending, event)) is not None:
                return replace(judged, notes=tuple(notes))
        beat.wait()
    return replace(ending, how="aborted", cause="interrupt", message="interrupted", notes=tuple(notes))


def _judgement(ending: Ending, event: Event) -> Ending | None:
    """Return the ending that a word at its end makes of it, None where it is no judgement."""
    match event.command:
        case command if command in VERDICTS:
            outcome = VERDICTS[command]
            return replace(ending, how="judged", outcome=outcome, clean=outcome == "success")
        case Command.DISCARD:
            return replace(ending, how="discard")
        case Command.QUIT:
            return replace(ending, how="discard", quits=True)
        case Command.RERECORD:
            return replace(ending, how="rerecord")
        case _:
            return None
