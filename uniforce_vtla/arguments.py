"""Read a command line ``key=value``, ``a.b=c`` or ``--a.b=c`` into a config dataclass."""

import ast
import dataclasses
import inspect
import io
import math
import re
import sys
import tokenize
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from itertools import pairwise
from operator import attrgetter, getitem
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import draccus
import numpy as np
import yaml
from draccus.utils import DraccusException

from uniforce_vtla.errors import ContractError, UniForceError, expected, nearest
from uniforce_vtla.options import (
    Existing,
    Writable,
    at_home,
    check_text,
    each,
    named_path,
    shortened,
    split,
)

KINDS = {
    int: "a whole number",
    float: "a number",
    bool: "true | false",
    str: "text",
    Any: "a value",
}


@dataclass(frozen=True)
class Option:
    """A field of a config: dotted name, type, default, rule and comment."""

    name: str
    kind: Any
    default: Any
    rule: Any = None
    comment: str = ""
    optional: bool = False  # whether ``null`` will do

    @property
    def wanted(self) -> str:
        """Values that may be given, in words."""
        if get_origin(self.kind) is Literal:
            return " | ".join(str(value) or '""' for value in get_args(self.kind))
        kind = KINDS.get(self.kind) or f"a list like {self.default or '[…]'}"
        if not self.rule:
            return kind
        if self.kind is str:
            return str(self.rule)
        return f"{kind}, {self.rule}"


def options_of(config_class: type, prefix: str = "") -> dict[str, Option]:
    """Return every option of a config class by its dotted name, nested ones included."""
    hints = get_type_hints(config_class, include_extras=True)
    comments = _comments(config_class)
    found: dict[str, Option] = {}
    for field in dataclasses.fields(config_class):
        name = prefix + field.name
        kind = hints[field.name]
        rule = None
        if get_origin(kind) is Annotated:
            kind, rule, *_ = get_args(kind)
        kind, optional = _without_none(kind)
        if dataclasses.is_dataclass(kind):
            found |= options_of(kind, f"{name}.")  # type: ignore[arg-type]
        elif field.init:
            default = field.default
            if field.default_factory is not dataclasses.MISSING:
                default = field.default_factory()
            found[name] = Option(name, kind, default, rule, comments.get(field.name, ""), optional)
    return found


def _without_none(kind: Any) -> tuple[Any, bool]:
    """Return T and True for ``T | None``, else the type and False."""
    if get_origin(kind) in (Union, UnionType) and len(get_args(kind)) == 2:
        first, second = get_args(kind)
        if second is type(None):
            return first, True
        if first is type(None):
            return second, True
    return kind, False


@cache
def _comments(config_class: type) -> dict[str, str]:
    """Return the comment of each field: above it, or beside it."""
    lines = inspect.getsource(config_class).splitlines()
    code = inspect.cleandoc("\n" + "\n".join(lines))
    found = {}
    for token in tokenize.generate_tokens(io.StringIO(code).readline):
        if token.type == tokenize.COMMENT:
            found[token.start[0]] = token.string.lstrip("# ")
    comments = {}
    earlier = 0
    for node in ast.parse(code).body[0].body:  # type: ignore[attr-defined]
        last = node.end_lineno
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            here = [comment for line, comment in found.items() if earlier < line <= last]
            comments[node.target.id] = " ".join(here)
        earlier = last
    return comments


def parse[ConfigT](
    config_class: type[ConfigT], argv: Sequence[str] | None = None, presets: Path | None = None
) -> ConfigT:
    """Parse ``argv`` (None: the process's own) into ``config_class`` and try every path in it.

    ``--help`` prints the class's docstring (give an example there) and every field with its
    comment. With ``presets``, ``preset=NAME`` reads ``NAME.yaml`` there first; other words
    override it.

    Raises ContractError: no such option or preset, a wrong type, a value out of range, a path that
    can't be used; SystemExit: after ``--help``.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(words):
        sys.stdout.write(f"{help_text(config_class)}\n")
        raise SystemExit(0)
    config, given = read(config_class, words, presets)
    for option in sorted(options_of(config_class).values(), key=lambda o: o.name not in given):
        check(option, attrgetter(option.name)(config))  # what was given comes first
    return config


def read[ConfigT](
    config_class: type[ConfigT], words: Sequence[str], presets: Path | None = None
) -> tuple[ConfigT, dict[str, str]]:
    """Return the config and option → text of what was given; ranges and paths are not checked.

    Raises ContractError: no such option or preset, a wrong type.
    """
    given = split_words(words)
    options = options_of(config_class)
    refuse_unknown(given, options)
    nested: dict[str, Any] = {}
    if presets is not None:
        nested = _preset(given.get("preset", ""), presets)
    for name, text in given.items():
        *path, last = name.split(".")
        inner = nested
        for key in path:
            inner = inner.setdefault(key, {})
        inner[last] = read_value(options[name], text)
    return _decode(config_class, nested), given


def split_words(words: Iterable[str]) -> dict[str, str]:
    """Return option → text of a command line.

    Raises ContractError: a word that is no ``key=value``, or an option that comes twice.
    """
    given = dict[str, str]()
    for word, after in pairwise([*words, ""]):
        name, equals, text = word.removeprefix("--").partition("=")
        if not equals or not name:
            do = "No space around the =."
            if word.startswith("--") and name and after and "=" not in after:
                do = f"Write {shortened(name)}={shortened(after)}."
            raise ContractError(expected("option", "key=value", shortened(word), do))
        if name in given:
            raise ContractError(expected(name, "one value", "two", "Give it once."))
        given[name] = text
    return given


def refuse_unknown(names: Iterable[str], known: Iterable[str]) -> None:
    """Raise ContractError for an option that isn't known; it names the nearest."""
    every = list(known)
    for name in set(names) - set(every):
        do = nearest(name, every, "--help lists them.", "=…")
        raise ContractError(expected("option", "one that this command has", shortened(name), do))


def read_value(option: Option, text: str) -> Any:
    """Return what the text says, before draccus makes it the field's type; a text stays as it is.

    Raises ContractError: it can't be of the option's type.
    """
    check_text(option.name, text)
    if not text and option.default != "":
        raise ContractError(
            expected(option.name, option.wanted, "nothing", "Give a value, or leave it out.")
        )
    if text == "null" and option.optional:
        return None
    value: Any = text
    if option.kind is not str and not isinstance(option.default, str):
        value = _read(option, text)
    elif isinstance(option.rule, Existing | Writable):
        value = at_home(text)
    if get_origin(option.kind) is Literal and value not in get_args(option.kind):
        raise _wrong(option, text)
    return value


def _read(option: Option, text: str) -> Any:
    try:
        if option.kind in (int, float):
            return option.kind(text)
        if option.kind is bool:
            return {"true": True, "false": False}[text.lower()]
        value = yaml.safe_load(text)
        if get_origin(option.kind) in (list, tuple) and not _is_list(value, get_args(option.kind)):
            raise ValueError(text)
        return value
    except (ValueError, KeyError, yaml.YAMLError) as error:
        raise _wrong(option, text) from error


def _is_list(value: Any, kinds: tuple[Any, ...]) -> bool:
    """Return whether it is a list of such entries; YAML reads ``a: b`` as a mapping."""
    if not isinstance(value, list):
        return False
    if Ellipsis not in kinds and len(kinds) > 1 and len(value) != len(kinds):
        return False
    for entry in value:
        if kinds[0] in (int, float) and not _is_number(entry):
            return False
        if kinds[0] is str and isinstance(entry, dict | list | bool | None):
            return False
    return True


def _is_number(entry: Any) -> bool:
    try:
        float(entry)
    except (TypeError, ValueError):
        return False
    return not isinstance(entry, bool)


def _wrong(option: Option, came: object) -> ContractError:
    return ContractError(expected(option.name, option.wanted, shortened(repr(came)), "Correct it."))


def _decode[ConfigT](config_class: type[ConfigT], nested: dict[str, Any]) -> ConfigT:
    try:
        return draccus.decode(config_class, nested)
    except draccus.utils.DecodingError as error:
        own = own_cause(error)
        if own is not None:
            raise own from error
        name = ".".join(error.key_path)
        for option in options_of(config_class).values():
            if f"{name}.".startswith(f"{option.name}."):
                came = reduce(getitem, option.name.split("."), nested)
                raise _wrong(option, came) from error
        raise ContractError(
            expected(name or "settings", "known ones", error.message, "Correct it.")
        ) from error


def own_cause(error: BaseException) -> UniForceError | None:
    """Return the error of ours that draccus wrapped, if any."""
    cause = reason_of(error)
    if isinstance(cause, UniForceError):
        return cause
    return None


def reason_of(error: BaseException) -> BaseException:
    """Return what began a chain of wrapped errors; an error of ours has said it in our words."""
    reason = error
    while reason.__cause__ is not None and not isinstance(reason, UniForceError):
        reason = reason.__cause__
    return reason


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML or JSON file, UTF-8 or UTF-16.

    Raises ContractError: it can't be read, is no text of these encodings, or no YAML.
    """
    with named_path(str(path), "a settings file"):
        content = path.read_bytes()
    try:
        return yaml.safe_load(content)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        do = "Save it as plain UTF-8 text, with the settings indented below their section."
        raise ContractError(
            expected(str(path), "YAML or JSON in UTF-8", shortened(str(error), 200), do)
        ) from error


def section(name: str, content: Any) -> dict[str, Any]:
    """Return a section of a settings file, empty where it is; ContractError: no section."""
    if content is not None and not isinstance(content, dict):
        do = "Write them as NAME: value, indented below it."
        raise ContractError(expected(name, "settings by name", shortened(repr(content)), do))
    if not content:
        return {}
    return {str(key): value for key, value in content.items()}


def decode_file[ConfigT](config_class: type[ConfigT], name: str, content: Any) -> ConfigT:
    """Return the config that a section of a settings file describes, defaults for empty parts.

    Raises ContractError, naming the setting: no section, nothing where a value must be, an unknown
    name, a wrong type, or whatever the class itself refuses.
    """
    settings = _without_empty(name, content, options_of(config_class))
    try:
        decoded: ConfigT = draccus.decode(config_class, settings)
    except (UniForceError, DraccusException, ValueError, TypeError) as error:
        path = ".".join((name, *getattr(error, "key_path", ())))
        reason = reason_of(error)
        if isinstance(reason, UniForceError):
            raise ContractError(_placed(path, str(reason))) from error
        came = str(getattr(reason, "message", reason)).rstrip(".")
        raise ContractError(
            expected(path, "settings it has", came, "See docs/recording.md.")
        ) from error
    return decoded


def _placed(path: str, reason: str) -> str:
    """Return a reason with the path of its setting in place of its class and field."""
    where, _, why = reason.partition(": ")
    field = re.fullmatch(r"\w+\.(\w+(\[\d+\])?)", where)
    if field is None:
        return f"{path}: {reason}"
    return f"{path}.{field[1]}: {why}"


def _without_empty(name: str, content: Any, options: Mapping[str, Option]) -> dict[str, Any]:
    """Return a section without empty ones in it; ContractError: an option without value."""
    kept = {}
    for key, value in section(name, content).items():
        path = f"{name}.{key}"
        inner = {}
        for place, setting in options.items():
            if place.startswith(f"{key}."):
                inner[place.removeprefix(f"{key}.")] = setting
        option = options.get(key)
        if inner and value is not None:
            kept[key] = _without_empty(path, value, inner)
            continue
        if option is not None and get_origin(option.kind) is not dict:
            if isinstance(value, dict):
                wanted = f"{option.wanted} for {path}"
                do = "It has no settings of its own."
                first = next(iter(value), "")
                raise ContractError(expected(f"{path}.{first}", wanted, "settings", do))
            if value is None and not option.optional:
                do = "Give a value, or leave it out."
                raise ContractError(expected(path, option.wanted, "nothing", do))
        if value is not None or (option is not None and option.optional):
            kept[key] = value
    return kept


def check(option: Option, value: Any) -> None:
    """Check a value against what its option declares.

    Raises ContractError: a number that isn't finite, or whatever the option's type refuses.
    """
    for part in each(value):
        if isinstance(part, float) and not math.isfinite(part):
            raise _wrong(option, part)
        if isinstance(part, str):
            check_text(option.name, part)
    if option.rule is not None:
        option.rule.check(option.name, value)


def help_text(config_class: type) -> str:
    """Return the class's docstring and a line or more for each option."""
    lines = [inspect.cleandoc(config_class.__doc__ or ""), ""]
    for option in options_of(config_class).values():
        default = str(option.default)
        if option.kind is bool:
            default = default.lower()
        line = f"  {option.name}={default}"
        if option.wanted not in ("text", KINDS[bool]):
            line += f"  [{option.wanted}]"
        lines += [line, f"      {option.comment}"]
    return "\n".join(lines)


def choose[T](known: dict[str, T], only: str, option: str = "only") -> dict[str, T]:
    """Return the entries named in an option, all when empty; ContractError: an unknown name."""
    names = split(only) or list(known)
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise ContractError(expected(option, " | ".join(known), unknown, "Name rows of the table."))
    return {name: known[name] for name in names}


def numbers(name: str, text: str, count: int) -> np.ndarray:
    """Return (count,) float64 of a setting like ``0.6,0.7``; ContractError: anything else."""
    try:
        found = np.array([float(part) for part in split(text)])
        if len(found) != count:
            raise ValueError(text)
        return found
    except ValueError as error:
        raise ContractError(
            expected(name, f"{count} numbers", repr(text), "Commas between them.")
        ) from error


def _preset(name: str, presets: Path) -> dict[str, Any]:
    """Return the settings of a preset; none where none is named."""
    if not name:
        return {}
    known = sorted(p.stem for p in presets.glob("*.yaml"))
    if name not in known:  # nor does a name with slashes lead out of the folder
        raise ContractError(
            expected("preset", " | ".join(known), shortened(name), "Name one, or give none.")
        )
    return yaml.safe_load((presets / f"{name}.yaml").read_text())
