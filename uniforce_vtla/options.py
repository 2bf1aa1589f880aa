"""Rules of options, declared as the type of a field: ranges, choices, names, files."""

import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Annotated, Any

from uniforce_vtla.errors import ContractError, expected, nearest
from uniforce_vtla.keys import VIEW_MARKER

LONGEST = 4000  # characters of any text


@dataclass(frozen=True)
class Range:
    """Finite numbers, ``low`` ≤ number ≤ ``high``; ``above`` excludes ``low`` itself."""

    low: float
    high: float
    above: bool = False

    def __str__(self) -> str:
        low = f"{self.low:,.12g}"
        high = f"{self.high:,.12g}"
        if self.above:
            return f"above {low}, at most {high}"
        return f"{low} … {high}"

    def holds(self, value: Any) -> bool:
        """Return whether a value is a finite number inside."""
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        if not is_number or (self.above and value == self.low):
            return False
        return bool(self.low <= value <= self.high)  # False for NaN

    def check(self, name: str, value: Any) -> None:
        """Raise ContractError for a number outside; of a list, for each."""
        for number in each(value):
            if not self.holds(number):
                raise ContractError(
                    expected(name, str(self), number, "Give a number of this range.")
                )


MANY = " (comma between them)"


@dataclass(frozen=True)
class Names:
    """Known names; ``many``: several, commas between, or a list; empty is the default."""

    known: tuple[str, ...]
    many: bool = False

    def __str__(self) -> str:
        return " | ".join(self.known) + MANY * self.many

    def check(self, name: str, value: str | list[str]) -> None:
        """Raise ContractError for a name that isn't known."""
        if not value:
            return
        if self.many and isinstance(value, str):
            value = split(value)
        unknown = [word for word in each(value) if word not in self.known]
        if unknown:
            do = nearest(unknown[0], self.known, "Choose of these.")
            raise ContractError(expected(name, str(self), ", ".join(unknown), do))


@dataclass(frozen=True)
class Pattern:
    """A text of one form."""

    form: str
    regex: str
    example: str

    def __str__(self) -> str:
        return self.form

    def check(self, name: str, value: str) -> None:
        """Raise ContractError for another form."""
        if value and not re.fullmatch(self.regex, value):
            raise ContractError(
                expected(name, self.form, shortened(value), f"Write it like {self.example}.")
            )


@dataclass(frozen=True)
class Plain:
    """Any printable text of a sane length."""

    def __str__(self) -> str:
        return "text"

    def check(self, name: str, value: str | list[str]) -> None:
        """Raise nothing: every text is checked by ``check_text``."""


def absolute(path: str | Path) -> Path:
    """Return where a path leads whatever folder a program changes to; ``~`` is the home folder.

    Some shells and every Python script leave the ``~`` of ``root=~/demos`` as it is.

    Raises ContractError: a user without a home.
    """
    try:
        return Path(path).expanduser().absolute()
    except (RuntimeError, OSError) as error:  # OSError: the current folder was deleted
        raise ContractError(
            expected(str(path), "a folder that leads somewhere", error, "Name another.")
        ) from error


def at_home(text: str) -> str:
    """Return a path, or several with commas between, with ``~`` as the home folder."""
    words = text.split(",")
    for i, word in enumerate(words):
        if word.strip().startswith("~"):
            words[i] = str(absolute(word.strip()))
    return ",".join(words)


@dataclass(frozen=True)
class Existing:
    """A file or folder that must be there; ``many``: several, commas between."""

    what: str  # its name in an error
    # file that the folder must hold; empty = the path is a file itself, ``.`` = any folder
    marker: str = ""
    words: tuple[str, ...] = ()  # names that stand for something else than a path
    many: bool = False
    hub: bool = False  # whether a hub id (``name/model``) will do
    made_by: str = ""  # command that makes one

    def __str__(self) -> str:
        return " | ".join([*self.words, self.what]) + MANY * self.many

    def check(self, name: str, value: str) -> None:
        """Raise ContractError where nothing of the kind is."""
        if not value:
            return
        do = "Check the path."
        if self.made_by:
            do = f"Make it with `{self.made_by}`, or check the path."
        words = split(value) if self.many else [value]
        for word in words:
            if word not in self.words and not self._found(name, word):
                raise ContractError(expected(name, str(self), shortened(word), do))

    def _found(self, name: str, word: str) -> bool:
        path = Path(word)
        with named_path(name, str(self)):
            if self.hub and not path.exists():
                return re.fullmatch(r"[\w-][\w.-]*/[\w-][\w.-]*", word) is not None
            if self.marker == ".":
                return path.is_dir()
            return (path / self.marker).is_file()


@dataclass(frozen=True)
class Writable:
    """Where a command writes: a folder or a file; tried before the work begins."""

    folder: bool = True

    def __str__(self) -> str:
        return f"a {_KINDS[self.folder]} that can be written"

    def check(self, name: str, value: str) -> None:
        """Raise ContractError where nothing can be written; removes all that the trial made."""
        if not value:
            return
        path = Path(value)
        with named_path(name, str(self)):
            if path.exists() and path.is_dir() != self.folder:
                came = f"{value}, a {_KINDS[not self.folder]}"
                raise ContractError(expected(name, str(self), came, "Name another."))
            try_to_write(path if self.folder else path.parent)


_KINDS = {True: "folder", False: "file"}


@contextmanager
def named_path(name: str, wanted: str) -> Iterator[None]:
    """Turn what the system says of a path into a ContractError that names the option."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a zero byte in a path
        reason = shortened(getattr(error, "strerror", None) or str(error))
        path = shortened(str(getattr(error, "filename", None) or ""))
        raise ContractError(
            expected(name, wanted, f"{reason} ({path})", "Name one that can be used.")
        ) from error


def try_to_write(folder: Path) -> None:
    """Make a folder and a file in it, then remove what is new; OSError: it can't be done."""
    missing = [part for part in (folder, *folder.parents) if not part.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        for part in missing:
            with suppress(OSError):  # never made, or another command has begun to write there
                part.rmdir()


def split(text: str) -> list[str]:
    """Return the entries of a text with commas between them."""
    return [entry.strip() for entry in text.split(",") if entry.strip()]


def each(value: Any) -> Sequence[Any]:
    """Return the entries of a list or tuple, or the value alone."""
    if isinstance(value, list | tuple):
        return value
    return [value]


def shortened(text: str, most: int = 80) -> str:
    """Return a text short enough for a line."""
    line = " ".join(text.split())
    if len(line) > most:
        line = f"{line[: most - 1]}…"
    return line


def check_text(name: str, value: str) -> None:
    """Raise ContractError for a text that is too long or holds control characters."""
    if len(value) > LONGEST:
        came = f"{len(value):,} characters"
        raise ContractError(expected(name, f"at most {LONGEST:,} characters", came, "Shorten it."))
    if not value.isprintable():
        raise ContractError(
            expected(
                name, "printable text", shortened(repr(value)), "Leave out control characters."
            )
        )


Count = Annotated[int, Range(1, 10_000_000)]
CountOrZero = Annotated[int, Range(0, 10_000_000)]
Workers = Annotated[int, Range(1, 256)]
Seed = Annotated[int, Range(0, 2**31 - 1)]
Seeds = Annotated[list[int], Range(0, 2**31 - 1)]
Pixels = Annotated[int, Range(8, 1024)]
Sizes = Annotated[tuple[float, float], Range(0, 1000, above=True)]
Share = Annotated[float, Range(0, 1)]
Rate = Annotated[float, Range(0, 1, above=True)]  # a learning rate
Positive = Annotated[float, Range(0, 1e6, above=True)]
NotNegative = Annotated[float, Range(0, 1e6)]
Text = Annotated[str, Plain()]
Texts = Annotated[list[str], Plain()]
FileName = Annotated[
    str, Pattern("a name without slashes", r"[\w+()×-][\w+()×. -]{0,99}", "my_table.json")
]
HubName = Annotated[
    str, Pattern("name/model", r"[\w-][\w.-]{0,95}/[\w-][\w.-]{0,95}", "your-name/wiping")
]
Slots = Annotated[
    str, Pattern("slot:finger pairs", r"\w+:(left|right)(,\s*\w+:(left|right))*", "touch0:left")
]
Numbers = Annotated[str, Pattern("numbers", r"-?\d*\.?\d+(\s*,\s*-?\d*\.?\d+)*", "0.6,0.7")]
RECORD = "uniforce record root=…"
FilePath = Annotated[str, Existing("a file")]
FolderPath = Annotated[str, Existing("a folder", ".")]
FolderPaths = Annotated[str, Existing("folders", ".", many=True)]
Dataset = Annotated[str, Existing("a recorded dataset's folder", "meta/info.json", made_by=RECORD)]
Datasets = Annotated[
    str, Existing("recorded datasets' folders", "meta/info.json", many=True, made_by=RECORD)
]
View = Annotated[
    str, Existing("a training view's folder", VIEW_MARKER, made_by="uniforce view roots=…")
]
TokenizerFolder = Annotated[
    str, Existing("a tokenizer's folder", "config.json", words=("small", "nano"))
]
Policies = Annotated[
    str,
    Existing(
        "checkpoints' folders",
        "config.json",
        words=("shipped", "expert"),
        many=True,
        made_by="uniforce train policy=pi05_uniforce",
    ),
]
OutFolder = Annotated[str, Writable()]
OutFile = Annotated[str, Writable(folder=False)]
