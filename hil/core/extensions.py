"""Finds what other packages register as entry points: laws, references, drivers, links, faults, commands, figures.

Each kind has a group, such as ``hil.laws``. A package registers a name in it:

    [project.entry-points."hil.laws"]
    my_law = "my_package.my_law:MyLaw"

Another package cannot replace a shipped name. An entry point is imported only when it is used.
"""

import sys
import sysconfig
import traceback
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.core.errors import BadInputError, nearest

if TYPE_CHECKING:
    import logging
    from importlib.metadata import EntryPoint

OUR_PACKAGE = "mecanum-hil"


@dataclass(frozen=True)
class Extensions:
    """The names of one kind: the ``shipped`` ones, and those registered in the entry point ``group``."""

    group: str
    shipped: Collection[str]

    def registered(self) -> "list[EntryPoint]":
        """Return the entry points of other packages, sorted by name. A package that is installed twice gives one."""
        return _registered(self.group, tuple(sys.path))

    def names(self) -> list[str]:
        """Return every name, the shipped ones first."""
        return [*self.shipped, *dict.fromkeys(p.name for p in self.registered() if p.name not in self.shipped)]

    def lines(self) -> list[tuple[str, str, str]]:
        """Return (name, package, description) of each registered entry point, for a list. Imports none of them."""
        points = self.registered()
        names = [point.name for point in points]
        return [(point.name, package_of(point), self._line(point, names)) for point in points]

    def module(self, name: str) -> str | None:
        """Return the module that has the object of a name; None for a shipped or unknown name. Imports nothing.

        ``name`` is registered, or ``package.module:Name`` itself.
        """
        if ":" in name:
            return name.rpartition(":")[0]
        value = next((p.value for p in self.registered() if p.name == name and name not in self.shipped), "")
        return value.rpartition(":")[0] or None

    def find(self, name: str, subject: str) -> "EntryPoint":
        """Return the entry point of a name that is not shipped. ``package.module:Name`` need not be registered.

        ``subject`` begins the error messages, for example ``law.name = 'my_law'``. Raises BadInputError for a name that
        no package registers (with similar names), that two packages register, or whose entry point is not of the form
        ``package.module:Name``.
        """
        if ":" in name:
            from importlib.metadata import EntryPoint

            return EntryPoint(name, name, self.group)
        same = [point for point in self.registered() if point.name == name]
        if not same:
            raise BadInputError(f"{subject}: unknown{nearest(name, self.names())}")
        if len(same) > 1:
            packages = " and ".join(f"{package_of(point)} ({point.value})" for point in same)
            raise BadInputError(f"{subject}: registered by {packages}; name one as 'package.module:Class'")
        if ":" not in same[0].value:
            begin = f"{from_package(subject, same[0])}: registered as {same[0].value!r}"
            raise BadInputError(f"{begin}, expected 'package.module:Class'")
        return same[0]

    def load(self, name: str, subject: str) -> Any:
        """Import and return the object of a name that is not shipped.

        Raises BadInputError as ``find`` does, and when the package cannot be imported or has no such object.
        """
        point = self.find(name, subject)
        try:
            return point.load()
        except (Exception, SystemExit) as error:  # someone else's code may raise anything
            begin = f"{from_package(subject, point)}: {point.value!r} cannot be loaded"
            _log(error)
            where = f", at {_place(error)}" if _root(_frames(error)) else ""
            raise BadInputError(f"{begin}: {type(error).__name__}: {error}{where}") from error

    def load_all(self, kind: str) -> Iterator[tuple[str, "EntryPoint", Any]]:
        """Import every registered object, and yield (subject for messages, entry point, object). Raises as ``load``.

        ``kind`` is the word for such an object, such as ``figure``.
        """
        for point in self.registered():
            subject = f"{kind} {point.name!r}"
            yield from_package(subject, point), point, self.load(point.name, subject)

    def _line(self, point: "EntryPoint", names: list[str]) -> str:
        if point.name in self.shipped:
            return f"not used: a shipped one has this name; use {point.value!r}"
        if names.count(point.name) > 1:
            return f"registered by more than one package; use {point.value!r}"
        return point.value


@cache
def _registered(group: str, path: tuple[str, ...]) -> "list[EntryPoint]":
    points = {(point.name, package_of(point)): point for point in _all_registered(path).select(group=group)}
    return [points[key] for key in sorted(points)]


@cache
def _all_registered(_path: tuple[str, ...]) -> Any:
    """Look for packages once for each module search path, because that takes milliseconds."""
    from importlib.metadata import entry_points  # here, because a recorder looks for none

    return entry_points()


def package_of(point: "EntryPoint") -> str:
    """Return the name of the package that registers an entry point."""
    return point.dist.name if point.dist is not None else "unknown"


def from_package(subject: str, point: "EntryPoint") -> str:
    """Return the beginning of an error message about another package's object."""
    return f"{subject}, of the package {package_of(point)}"


@contextmanager
def failures_of(where: str, activity: str) -> Iterator[None]:
    """Turn every exception that another package's code raises in the block into the BadInputError of ``failure``."""
    try:
        yield
    except BadInputError:
        raise
    except (Exception, SystemExit) as error:  # someone else's code may raise anything
        raise failure(where, activity, error) from error


def failure(where: str, activity: str, error: BaseException) -> BadInputError:
    """Return a BadInputError with the text ``where: activity failed at FILE:LINE (source): ...`` for another's error.

    The line is the last of that code, not of a library which it calls. The whole traceback goes to the log.
    """
    _log(error)
    return BadInputError(f"{where}: {activity} failed at {_place(error)}: {type(error).__name__}: {error}")


def _log(error: BaseException) -> None:
    _logger().error("code of others failed", exc_info=error)


@contextmanager
def tracebacks_shown() -> Iterator[None]:
    """Write the tracebacks of failures to stderr."""
    import logging

    handler = logging.StreamHandler()
    _logger().addHandler(handler)
    try:
        yield
    finally:
        _logger().removeHandler(handler)


def _logger() -> "logging.Logger":
    import logging  # not at the top: most runs log nothing

    logger = logging.getLogger("hil.extensions")
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())  # without any, Python would write to stderr
    return logger


_MOST_SOURCE = 100  # characters
_OURS = Path(__file__).parents[1]
_LIBRARIES = ("site-packages", "dist-packages")


def _place(error: BaseException) -> str:
    """Return file, line and source of the last line of the code that we called."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = _frames(error)
    if not frames:
        return "an unknown place"
    frame = ([f for f in frames if _is_below(_root(frames), f)] or frames)[-1]
    source = (frame.line or "")[:_MOST_SOURCE]
    return f"{frame.filename}:{frame.lineno}" + (f" ({source})" if source else "")


def _frames(error: BaseException) -> list[traceback.FrameSummary]:
    return [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]


def _root(frames: "Sequence[traceback.FrameSummary]") -> Path | None:
    """Return the folder of the code that we called: of an installed package its own, of a file the one around it."""
    standard = Path(sysconfig.get_path("stdlib"))
    for file in (Path(frame.filename) for frame in frames):
        # Ours may be in a folder of libraries too, and so is the one that takes the place of importlib.metadata.
        if _OURS in file.parents or file.parent.name == "importlib_metadata":
            continue
        libraries = [i for i, part in enumerate(file.parts) if part in _LIBRARIES]
        if libraries:
            return Path(*file.parts[: libraries[-1] + 2])
        if standard not in file.parents:
            return file.parent
    return None


def _is_below(root: Path | None, frame: traceback.FrameSummary) -> bool:
    """Return whether a frame is of the code below this folder, and of no library in a folder of its own there."""
    file = Path(frame.filename)
    if root is None or _OURS in file.parents or not (root == file or root in file.parents):
        return False
    return not any(part in _LIBRARIES for part in file.relative_to(root).parts)
