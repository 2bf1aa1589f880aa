"""Command lines that must be refused, made from the options a command declares: a new option is tried, too."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args, get_origin

from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_datasets.synthetic import record_synthetic
from uniforce_datasets.training_view import build_view
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.options import LONGEST, Existing, Names, Pattern, Range, Writable
from uniforce_vtla.tokenizer.weights import ASSETS, DEFAULT_SIZE

CONTENTS = {  # of files that a user may name by mistake
    "garbage": b"\xff\xfe{]garbage\x00" * 16,
    "empty": b"",
    "latin1": "robot: # Größe\n".encode("latin-1"),
    "list": b"[1, 2]",
    "number": b"7",
    "object": b'{"a": null}',
}
TOKENIZER = ASSETS / DEFAULT_SIZE / "tokenizer"
WRONG_TYPE = {
    int: ("many", "1.5", "true", "[1]", "null", "1:30", "nan"),
    float: ("much", "true", "[1.0]", "null", "nan", "inf", "-inf", "1e999"),
    bool: ("maybe", "2", "null", "yes"),
    list: ("7", "[nosuch: ]", "[1", "{a: 1}"),
    tuple: ("7", "[1.0]", "[1.0, x]"),
}
TEXTS = ("x" * (LONGEST + 1), "a\x07b", "a\nb")


@dataclass(frozen=True)
class BadInput:
    """Words of a command line, what is wrong with them, and the option that is."""

    kind: str
    words: tuple[str, ...]
    option: str

    def is_named_in(self, line):
        """Return whether a refusal is of this: said at its beginning, as what came, in backticks, as what was meant.

        A long word counts anywhere: ``out`` or ``1`` stand in many a line about something else.
        """
        reason, names = line.partition(": ")[2], {self.option, self.option.rpartition(".")[2]}
        given = {word.removeprefix("--").partition("=")[2] for word in self.words}
        places = r"(^|got (--)?|mean |`)([\w.]*\.)?"
        if any(re.search(rf"{places}{re.escape(name)}(?!\w| of)", reason) for name in names):
            return True
        held = {text for text in names if len(text) > 4} | {text for text in given if len(text) > 5}
        return any(re.search(rf"(?<!\w){re.escape(text)}", reason) for text in held)


@dataclass(frozen=True)
class Room:
    """Sound and damaged files and folders to name on a command line."""

    folder: Path

    def build(self):
        record_synthetic(self.folder / "dataset", 1, 20)
        build_view(self.folder / "dataset", self.folder / "view")
        (self.folder / "some_folder").mkdir()
        for name, content in CONTENTS.items():
            (self.folder / name).write_bytes(content)
            for marker in ("meta/info.json", VIEW_MARKER, "config.json"):
                file = self.damaged(name, marker) / marker
                file.parent.mkdir(parents=True)
                file.write_bytes(content)
        return self

    def damaged(self, name, marker):
        return self.folder / f"{name}_{marker.replace('/', '_')}"

    def sound(self, marker):
        whole = {"meta/info.json": self.folder / "dataset", VIEW_MARKER: self.folder / "view"}
        return whole.get(marker, shipped_checkpoint())


def bad_inputs(options, room):
    for option in options.values():
        for kind, text in bad_values(option, room):
            yield BadInput(kind, (f"{option.name}={text}",), option.name)
    yield from bad_forms(options)


def bad_forms(options):
    names = list(options)
    first, last = names[0], names[-1]
    yield BadInput("unknown", ("no_such_option=1",), "no_such_option")
    yield BadInput("unknown", (f"{last}.no_such=1",), f"{last}.no_such")
    yield BadInput("unknown", ("=1",), "option")
    for name in (first, last):
        yield BadInput("misspelt", (f"{name}{name[-1]}=1",), name)
        yield BadInput("no value", (f"--{name}",), name)
        yield BadInput("no value", (name, "1"), name)
        yield BadInput("twice", (f"{name}=1", f"--{name}=1"), name)


def bad_values(option, room):
    kind = option.kind
    if option.default or not isinstance(option.default, str | None):
        yield "empty", ""
    if get_origin(kind) is Literal:
        yield from (("choice", text) for text in ("nosuch", f"../{get_args(kind)[-1]}"))
        return
    wrong = WRONG_TYPE.get(get_origin(kind) or kind, ())
    yield from (("type", text) for text in wrong if text != "null" or not option.optional)
    if isinstance(option.rule, Range):
        yield from (("range", _listed(kind, number)) for number in _outside(option.rule, kind))
    if kind is str:
        yield from (("text", text) for text in TEXTS)
        yield from _bad_texts(option.rule, room)
    if isinstance(option.rule, Names) and kind is not str:
        yield "choice", "[nosuch]"


def _outside(allowed, kind):
    step = 1 if kind is int else 0.001
    below = allowed.low if allowed.above else allowed.low - step
    return below, allowed.high + max(step, abs(allowed.high) * 1e-3)


def _listed(kind, number):
    is_whole = int in (kind, *get_args(kind))
    text = str(int(number)) if is_whole else repr(float(number))
    return {list: f"[{text}]", tuple: f"[{text}, {text}]"}.get(get_origin(kind), text)


def _bad_texts(rule, room):
    if isinstance(rule, Names):
        yield "choice", "nosuch"
        yield "choice", f"../{rule.known[0]}"
        if rule.many:
            yield "choice", f"{rule.known[0]},nosuch"
    if isinstance(rule, Pattern):
        yield "text", "../../nosuch"
        yield "text", "!\\"
    if isinstance(rule, Existing):
        yield from _bad_sources(rule, room)
    if isinstance(rule, Writable):
        yield from _bad_targets(rule, room)


def _bad_sources(rule, room):
    here = room.folder
    yield "missing", str(here / "nothing_here")
    yield "missing", str(here / ("n" * 300))
    yield "missing", str(here / "garbage" / "below")
    if rule.marker:
        yield "file for folder", str(here / "garbage")
    kind = {"": "folder for file", ".": "nothing in it"}.get(rule.marker, "missing")
    yield kind, str(here / "some_folder")
    if rule.marker == "config.json":
        yield "another kind", str(TOKENIZER if "checkpoint" in rule.what else shipped_checkpoint())
    if rule.marker != ".":
        for name in CONTENTS:
            yield "damaged", str(room.damaged(name, rule.marker) if rule.marker else here / name)


def _bad_targets(rule, room):
    name = "out" if rule.folder else "out.json"
    places = ("/proc/nothing", "/sys/nothing", str(room.folder / "garbage"), f"/tmp/{'n' * 300}")
    yield from (("unwritable", f"{place}/{name}") for place in places)
    yield "unwritable", str(room.folder / ("n" * 300))
    if rule.folder:
        yield "file for folder", str(room.folder / "garbage")
    else:
        yield "folder for file", str(room.folder / "some_folder")
