"""One error tree. Each class carries the exit code that the command line gives for it.

A message names the thing, the value, what was expected and what to do; it is shown to the user as it is,
without a traceback.
"""

import difflib
from collections.abc import Iterable


class HilError(Exception):
    """Base of every error that a user is meant to read."""

    exit_code = 2


class BadInputError(HilError):
    """A scenario, an option or a file is wrong: nothing was started (exit code 2)."""


class LinkError(HilError):
    """The link could not be opened, or was lost (exit code 3)."""

    exit_code = 3


class DeviceError(HilError):
    """The device did not answer, refused, or stopped (exit code 3)."""

    exit_code = 3


class RobotStoppedError(DeviceError):
    """The robot left ACTIVE, was reset or is silent, but not in FAULT or ESTOP: arming it anew may bring it back."""


class RunInterruptedError(HilError):
    """Somebody ended the run with Ctrl-C or SIGTERM (exit code 130, as shells have it)."""

    exit_code = 130


def nearest(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known word nearest to ``word``, or the choice itself.

    >>> nearest("mas_kg", ["mass_kg", "law"])
    "; did you mean 'mass_kg'?"
    """
    choice = list(known)
    found = difflib.get_close_matches(word, choice, n=1, cutoff=0.6)
    if found:
        return f"; did you mean {found[0]!r}?"
    return f"; known: {', '.join(sorted(choice))}" if choice else ""
