"""Every error a user can meet: what was expected, what came, what to do."""

import difflib
import errno
import os
import re
from collections.abc import Collection, Iterable


class UniForceError(Exception):
    """Base of all errors raised on purpose by this project."""


class SensorError(UniForceError):
    """A raw tactile signal can't be used: unknown sensor, no markers, dead, frozen, in contact."""


class ContractError(UniForceError):
    """An array or setting breaks a contract: shape, dtype, NaN, missing reference or key."""


class CheckpointError(UniForceError):
    """A checkpoint is missing, truncated, or does not fit what is running."""


class DatasetError(UniForceError):
    """A dataset can't be trusted: lossy tactile video, dropped frame, missing reference."""


class DiskFullError(DatasetError):
    """No room to store the episode; those saved before are intact."""


class DroppedFrameError(DatasetError):
    """A video frame could not be encoded in time; the episode is discarded."""


class RolloutError(UniForceError):
    """A rollout had to stop: lost touch, non-finite action, broken episode."""


class FaultError(UniForceError):
    """An error of a device; programs branch on ``fault``, people read the message."""

    def __init__(self, message: str, fault: str = "other") -> None:
        super().__init__(message)
        self.fault = fault


class RobotError(FaultError):
    """The robot can't be moved: no answer, wrong version, reflex, user stop, a refused action.

    Attributes:
        fault: one word for what happened. The robot's own: ``connection``, ``version``, ``reflex``,
            ``user_stop``, ``guiding``, ``communication``, ``discontinuity``, ``limit``. Impossible
            reports: ``bad_state``, ``jump``, ``speed``, ``force``, ``frozen``, ``stale``. Ours:
            ``action``, ``guard``, ``sensor``, ``ended``, ``backend``. The hand's:
            ``hand_connection``, ``hand_stale``, ``hand_deadline``, ``hand_state``,
            ``grasp_lost``. And ``other``.
    """


class TeleoperatorError(FaultError):
    """A teleoperator can't be followed: unplugged, silent, garbage, too far from the robot.

    Attributes:
        fault: one word for what happened: ``connection``, ``stale``, ``garbage``, ``far``,
            ``not_started``, ``not_connected``, ``missing`` (a library) or ``other``.
    """


# user:password@ of an address; a password may hold a slash or a quote
LOGIN = re.compile(r"(?<=://)[^\s\"]*@")
ADDRESS = re.compile(r"(?i)(\b[a-z][\w+.-]*://[^\s\"'<>/?#]*)((?:[^\s\"'<>\\]|\\(?!\"))*)")
# of an address' path: a key may stand there as well as behind a question mark
SHOWN_WORDS = re.compile(
    r"\d{0,3}|api|axis-cgi|cams?|camera|cgi|cgi-bin|channel|feed|front|image|jpg|left|live|main|"
    r"mjpe?g|path|raw|right|"
    r"snapshot|stream(ing)?|sub|tactile|v\d|video(\.cgi|\.mjpe?g|_feed)?|webcam|wrist"
)
SHOWN_SETTINGS = re.compile(  # behind its question mark
    r"action|camera|channel|codec|compression|fps|height|quality|rate|resolution|rotation|size|"
    r"stream|video|width|x|y"
)
PUBLIC = (
    "https://huggingface.co/",
    "https://hf.co/",
    "https://github.com/",
    "https://ai.google.dev/",
)


def without_credentials(text: str) -> str:
    """Return a text with logins, and all of its addresses not known to be harmless, as stars."""
    return ADDRESS.sub(_harmless, LOGIN.sub("***@", text))


def _harmless(address: re.Match[str]) -> str:
    if address.group().startswith(PUBLIC) and "?" not in address.group():
        return address.group()
    where, tail = address.groups()
    shown = tail.rstrip(".,;:!)]}")
    path, mark, settings = shown.partition("#")[0].partition("?")
    words = path.split("/")
    for i, word in enumerate(words):
        if not SHOWN_WORDS.fullmatch(word):
            words[i] = "***"
    pairs = [_setting(pair) for pair in settings.split("&")]
    hidden = "#***" if "#" in shown else ""
    return where + "/".join(words) + mark + "&".join(pairs) + hidden + tail[len(shown) :]


def _setting(pair: str) -> str:
    name, equals, _ = pair.partition("=")
    if not pair or SHOWN_SETTINGS.fullmatch(name):
        return pair
    if not equals:
        return "***"
    return f"{name}=***"


def expected(what: str, wanted: object, came: object, do: str) -> str:
    """Compose an error message, without the credentials of any address in it."""
    return without_credentials(f"{what}: expected {wanted}, got {came}. {do}")


def nearest(came: str, known: Iterable[str], otherwise: str, mark: str = "") -> str:
    """Return what to do about an unknown name: take the nearest known one, or ``otherwise``.

    A ``mark`` follows the name, ``=…`` that of an option.
    """
    near = difflib.get_close_matches(came, known, 1)
    return f"Did you mean {near[0]}{mark}?" if near else otherwise


def described(value: object) -> str:
    """Return dtype and shape of an array for ``expected``; of anything else its type."""
    return f"{getattr(value, 'dtype', type(value).__name__)} {getattr(value, 'shape', None)}"


# no room on the disk, in a user's quota, or in the largest file that a system or shell allows
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def no_room(error: BaseException) -> bool:
    """Return whether an error says that a disk is full, by its number or in words."""
    if isinstance(error, DiskFullError) or getattr(error, "errno", None) in FULL:
        return True
    return any(os.strerror(number) in str(error) for number in FULL)


def not_stored(what: str, wanted: str, error: BaseException, do: str) -> DatasetError:
    """Return the error for what could not be written: a DiskFullError where there is no room."""
    if no_room(error):
        return DiskFullError(expected(what, wanted, error, f"Free some space. {do}"))
    return DatasetError(expected(what, wanted, error, do))


def require_one_of(
    what: str, value: object, known: Collection[object], do: str = "Name one."
) -> None:
    """Check a choice; raise ContractError, which names all there are, for none of them."""
    if value not in known:
        raise ContractError(expected(what, " | ".join(map(str, known)), repr(value), do))
