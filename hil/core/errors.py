"""One error tree. Each class carries the exit code that the command line gives for it.

A message names the thing, the value, the expected value and the remedy. The user sees it unchanged, without
a traceback.
"""

import difflib
import errno
from collections.abc import Iterable


class HilError(Exception):
    """Base class of the errors whose messages are shown to the user."""

    exit_code = 2


class BadInputError(HilError):
    """A scenario, an option or a file is wrong: nothing was started (exit code 2)."""


class UnknownSignalError(BadInputError, KeyError):
    """A run has no signal of this name. It is also a KeyError, because ``in`` and ``get`` of a mapping expect one."""

    __str__ = Exception.__str__  # KeyError.__str__ would put quotation marks around the message

    def __init__(self, name: object, known: Iterable[str]) -> None:
        super().__init__(f"the run has no signal {name!r}{nearest(str(name), known, SEE_SIGNALS)}")


class LinkError(HilError):
    """The link could not be opened, or was lost (exit code 3)."""

    exit_code = 3


class DeviceError(HilError):
    """The device did not answer, refused, or stopped (exit code 3)."""

    exit_code = 3


class RobotStoppedError(DeviceError):
    """The robot left ACTIVE, was reset or is silent, but is not in FAULT or ESTOP. Arming it again may help."""


class RobotLatchedError(DeviceError):
    """The robot left ACTIVE and is in FAULT or ESTOP, which only CLEAR ends."""


class OverdueError(HilError):
    """A tick took longer than ``loop.tick_limit_s``, for example because the law does not return (exit code 3)."""

    exit_code = 3


class RunInterruptedError(HilError):
    """Ctrl-C or SIGTERM ended the run (exit code 130, as in a shell)."""

    exit_code = 130


def kind_of(error: HilError) -> str:
    """Return the name of an error's class, or of the nearest class above it that is defined here."""
    return next(kind.__name__ for kind in type(error).__mro__ if kind.__module__ == __name__)


def error_of(kind: str | None, sentence: str) -> HilError:
    """Return an error by the name of its class, as ``kind_of`` gives it; a DeviceError where the name is not known."""
    kinds = HilError, BadInputError, LinkError, OverdueError, RobotLatchedError, RobotStoppedError, RunInterruptedError
    return next((one for one in kinds if one.__name__ == kind), DeviceError)(sentence)


_NEAR = 0.75
_MOST_NAMED = 3


def near(word: str, known: Iterable[str]) -> list[str]:
    """Return the known words that are similar to ``word``: at most three, or an empty list.

    Case is ignored, a hyphen equals an underscore, and a part of a known word matches it. Otherwise the similarity of
    the letters decides. A common prefix such as ``wheel.fl.`` does not count, because all signals of a wheel share it.
    """
    folded = {one: _folded(one) for one in known}
    meant = _folded(word)
    if same := [one for one, fold in folded.items() if fold == meant]:
        return same[:1]
    parts = [one for one, fold in folded.items() if _is_part(meant, fold)]
    if 1 <= len(parts) <= _MOST_NAMED:
        return parts
    likeness = {one: _likeness(meant, fold) for one, fold in folded.items()}
    most = max((_NEAR, *likeness.values()))
    best = [one for one, value in likeness.items() if value == most]
    return best if len(best) <= _MOST_NAMED else []


def _is_part(word: str, known: str) -> bool:
    """Return whether ``known`` begins with ``word``, or contains it as whole parts between dots or underscores."""
    parts, words = (f"_{one}_".replace(".", "_") for one in (word, known))
    return len(word) > 1 and (known.startswith(word) or parts in words)


def _folded(word: str) -> str:
    return word.casefold().replace("-", "_")


def _likeness(word: str, known: str) -> float:
    word_head, word_dot, word_rest = word.partition(".")
    head, dot, rest = known.partition(".")
    if word_dot and dot and word_head == head:
        return _likeness(word_rest, rest)
    if sorted(word) == sorted(known):
        return 1.0  # the same letters in another order: the ratio below is too low for this in a short name
    return difflib.SequenceMatcher(None, known, word).ratio()


def remedy(error: OSError, otherwise: str) -> str:
    """Return the remedy for a file that cannot be written: on a full disk to make room, else ``otherwise``."""
    return f"make room, or {otherwise}" if error.errno in (errno.ENOSPC, errno.EDQUOT) else otherwise


def apart(value: float, *bounds: float, digits: int = 3) -> str:
    """Return a number in ``digits`` digits, or in more if it needs them to be on its own side of each bound.

    For sentences that say that a value is beyond a limit: both rounded to the same text would deny it. A difference in
    the 13th digit only is the rounding of a sum, and is shown as equal.

    >>> apart(0.8496, 0.85, digits=2)
    '0.8496'
    """

    def sides(number: float) -> list[tuple[bool, bool]]:
        return [(number < bound, number > bound) for bound in bounds]

    texts = [f"{value:.{count}g}" for count in range(digits, 13)]
    return next((text for text in texts if sides(float(text)) == sides(value)), texts[0])


SEE_SIGNALS = "; `hil list signals` prints them all"
"""For ``nearest`` of a signal: the names of all are too long for a sentence."""


def nearest(word: str, known: Iterable[str], otherwise: str | None = None) -> str:
    """Return ``"; did you mean 'x'?"`` with the known words that are similar to ``word``.

    If none is, return ``otherwise``, by default a list of all known words.

    >>> nearest("mas_kg", ["mass_kg", "law"])
    "; did you mean 'mass_kg'?"
    """
    choice = list(known)
    if found := near(word, choice):
        return f"; did you mean {' or '.join(map(repr, found))}?"
    if otherwise is not None:
        return otherwise
    return f"; known: {', '.join(sorted(choice))}" if choice else ""
