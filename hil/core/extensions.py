"""Finds what packages register as entry points: laws, references, drivers, boards, links, faults, commands.

Each kind has a group, such as ``hil.laws``. A package registers a name in it:

    [project.entry-points."hil.laws"]
    my_law = "my_package.my_law:MyLaw"

This package registers parts in the same way, in its ``pyproject.toml``. Its names are shipped: another package cannot
replace them. One whose add-on has been removed is left out. An entry point is imported only when it is used.
"""

import importlib.util
import os
import sys
import sysconfig
import traceback
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hil.core.errors import BadInputError, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

OUR_PACKAGE = "mecanum-hil"
_TRACEBACKS, _NO_CODE = "HIL_TRACEBACKS", "HIL_NO_CODE"


def is_installed(place: str) -> bool:
    """Return whether the module of ``package.module:name`` is there. Imports only the packages around it."""
    try:
        return importlib.util.find_spec(place.partition(":")[0]) is not None
    except ModuleNotFoundError:
        return False


@dataclass(frozen=True)
class Extensions:
    """The names of one kind: the shipped ones, of the ``core`` and of this package's entry points of the ``group``, and
    those that other packages register.
    """

    group: str
    core: Collection[str] = ()

    @property
    def ours(self) -> "Mapping[str, EntryPoint]":
        """The entry points of this package by name, without those whose add-on has been removed."""
        return {name: point for name, point in _ours(self.group).items() if is_installed(point.value)}

    @property
    def shipped(self) -> tuple[str, ...]:
        """The shipped names: the core's, then those that this package registers."""
        return (*self.core, *self.ours)

    def is_shipped(self, name: str) -> bool:
        """Return whether a name is shipped. This looks at no other package."""
        return name in self.core or self._our(name) is not None

    def __contains__(self, name: str) -> bool:
        """Return whether a name is shipped or registered. Looks at other packages only for one that is not shipped."""
        return self.is_shipped(name) or any(point.name == name for point in self.registered())

    def registered(self) -> "list[EntryPoint]":
        """Return the entry points of other packages, sorted by name. A package that is installed twice gives one."""
        return _registered(self.group, tuple(sys.path))

    def names(self) -> list[str]:
        """Return every name, the shipped ones first."""
        shipped = self.shipped
        return [*shipped, *dict.fromkeys(p.name for p in self.registered() if p.name not in shipped)]

    def lines(self) -> list[tuple[str, str, str]]:
        """Return (name, package, description) of other packages' entry points, for a list. Imports none of them."""
        points = self.registered()
        names = [point.name for point in points]
        return [(point.name, package_of(point), self._line(point, names)) for point in points]

    def module(self, name: str) -> str | None:
        """Return the module that has another package's object; None for a shipped or unknown name. Imports nothing.

        ``name`` is registered, or ``package.module:Name`` itself.
        """
        if ":" in name:
            return name.rpartition(":")[0]
        if self.is_shipped(name):
            return None
        return next((p.value for p in self.registered() if p.name == name), "").rpartition(":")[0] or None

    def find(self, name: str, subject: str) -> "EntryPoint":
        """Return the entry point of a registered name. ``package.module:Name`` need not be registered.

        ``subject`` begins the error messages, for example ``law.name = 'my_law'``. Raises BadInputError if
        no package registers the name (with similar names), if two other packages register it, if its add-on has been
        removed, or if its entry point is not of the form ``package.module:Name``.
        """
        if ":" in name:
            from importlib.metadata import EntryPoint

            return EntryPoint(name, name, self.group)
        if ours := self._our(name):
            return ours
        same = [point for point in self.registered() if point.name == name]
        if not same:
            raise BadInputError(f"{subject}: {self.unknown(name)}")
        if len(same) > 1:
            packages = " and ".join(f"{package_of(point)} ({point.value})" for point in same)
            raise BadInputError(f"{subject}: registered by {packages}; name one as 'package.module:Class'")
        if ":" not in same[0].value:
            begin = f"{from_package(subject, same[0])}: registered as {same[0].value!r}"
            raise BadInputError(f"{begin}, expected 'package.module:Class'")
        return same[0]

    def unknown(self, name: str, problem: str = "unknown") -> str:
        """Return why a name cannot be used: its add-on has been removed, or ``problem`` with similar names."""
        if removed := _ours(self.group).get(name):
            addon = ".".join(removed.value.split(".")[:3])
            return f"it belongs to {addon}, which is not installed; reinstall {OUR_PACKAGE}"
        return f"{problem}{nearest(name, self.names())}"

    def load(self, name: str, subject: str) -> Any:
        """Import and return the object of a registered name.

        Raises BadInputError as ``find`` does, and when another package cannot be imported or has no such object.
        """
        if ours := self._our(name):
            return ours.load()
        point = self.find(name, subject)
        try:
            return point.load()
        except (Exception, SystemExit) as error:  # someone else's code may raise anything
            begin = f"{from_package(subject, point)}: {point.value!r} cannot be loaded"
            _log(error)
            where = f", at {_place(error)}" if _theirs(error) else ""
            raise BadInputError(f"{begin}: {type(error).__name__}: {error}{where}") from error

    def load_all(self, kind: str) -> Iterator[tuple[str, "EntryPoint", Any]]:
        """Import every object of other packages; yield (subject for messages, entry point, object). Raises as ``load``.

        ``kind`` is the word for such an object, such as ``figure``.
        """
        for point in self.registered():
            subject = f"{kind} {point.name!r}"
            yield from_package(subject, point), point, self.load(point.name, subject)

    def failures(self, name: str, subject: str, activity: str) -> AbstractContextManager[None]:
        """Turn every exception that another package's code raises in the block into a BadInputError; see ``failure``.

        Exceptions of shipped code are defects, and pass.
        """
        if self.is_shipped(name):
            return nullcontext()
        return failures_of(from_package(subject, self.find(name, subject)), activity)

    def _our(self, name: str) -> "EntryPoint | None":
        point = _ours(self.group).get(name)
        return point if point is not None and is_installed(point.value) else None

    def _line(self, point: "EntryPoint", names: list[str]) -> str:
        if self.is_shipped(point.name):
            return f"not used: a shipped one has this name; use {point.value!r}"
        if names.count(point.name) > 1:
            return f"registered by more than one package; use {point.value!r}"
        return point.value


@cache
def _ours(group: str) -> "Mapping[str, EntryPoint]":
    """Return the entry points of this package. Other packages are not looked for, because that takes milliseconds."""
    return {point.name: point for point in _all_ours() if point.group == group}


@cache
def _all_ours() -> "Sequence[EntryPoint]":
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        return distribution(OUR_PACKAGE).entry_points
    except PackageNotFoundError:
        return ()


def _is_ours(point: "EntryPoint") -> bool:
    return package_of(point) == OUR_PACKAGE


@cache
def _registered(group: str, path: tuple[str, ...]) -> "list[EntryPoint]":
    points = {(point.name, package_of(point)): point for point in _all_registered(path).select(group=group)}
    return [points[key] for key in sorted(points) if not _is_ours(points[key])]


@cache
def _all_registered(_path: tuple[str, ...]) -> Any:
    """Look for packages once for each module search path, because that takes milliseconds."""
    from importlib.metadata import entry_points  # here, because a recorder looks for none

    return entry_points()


def package_of(point: "EntryPoint") -> str:
    """Return the name of the package that registers an entry point."""
    return point.dist.name if point.dist is not None else "unknown"


def from_package(subject: str, point: "EntryPoint") -> str:
    """Return the beginning of an error message about an object: ``subject``, with the package if it is another's."""
    return subject if _is_ours(point) else f"{subject}, of the package {package_of(point)}"


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

    The line is the last of that code, not of a library which it calls. ``tracebacks_shown`` has the whole one printed.
    """
    _log(error)
    return BadInputError(f"{where}: {activity} failed at {_place(error)}: {type(error).__name__}: {error}")


@contextmanager
def tracebacks_shown() -> Iterator[None]:
    """Write the tracebacks of failures to stderr, in this process and in those that it starts."""
    os.environ[_TRACEBACKS] = "1"
    try:
        yield
    finally:
        del os.environ[_TRACEBACKS]


def _log(error: BaseException) -> None:
    if os.environ.get(_TRACEBACKS):
        traceback.print_exception(error)


_MOST_SOURCE = 100  # characters
_OURS = Path(__file__).parents[1]
_LIBRARIES = ("site-packages", "dist-packages")


def _place(error: BaseException) -> str:
    """Return file, line and source of the last line of the code that we called."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frame = (_theirs(error) or _frames(error))[-1]
    source = (frame.line or "")[:_MOST_SOURCE]
    return f"{frame.filename}:{frame.lineno}" + (f" ({source})" if source else "")


def _frames(error: BaseException) -> list[traceback.FrameSummary]:
    return [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]


def _theirs(error: BaseException) -> list[traceback.FrameSummary]:
    """Return the frames of the code that we called: of an installed package, or of the folder around a file.

    Those of libraries that it calls, which may be in a folder of their own there, are left out.
    """
    frames, standard = _frames(error), Path(sysconfig.get_path("stdlib"))
    for file in (Path(frame.filename) for frame in frames):
        libraries = [i for i, part in enumerate(file.parts) if part in _LIBRARIES]
        # Ours may be in a folder of libraries too, and so is the one that takes the place of importlib.metadata.
        is_ours = _OURS in file.parents or file.parent.name == "importlib_metadata"
        if is_ours or (not libraries and standard in file.parents):
            continue
        root = Path(*file.parts[: libraries[-1] + 2]) if libraries else file.parent
        below = [(f, Path(f.filename)) for f in frames if Path(f.filename).is_relative_to(root)]
        theirs = [(f, path) for f, path in below if _OURS not in path.parents]  # ours may be below their folder
        return [f for f, path in theirs if not {*_LIBRARIES}.intersection(path.relative_to(root).parts)]
    return []


def refuse_code() -> None:
    """Refuse laws in Python files and FMUs, native libraries, from now on, also in processes that this one starts."""
    os.environ[_NO_CODE] = "1"


def code_is_refused() -> bool:
    """Return whether code of files is refused."""
    return os.environ.get(_NO_CODE, "") not in ("", "0")


def check_may_run(what: str) -> None:
    """Raise BadInputError, whose message begins with ``what``, where code of files is refused."""
    if code_is_refused():
        raise BadInputError(
            f"{what}: it is code, and --no-code (or {_NO_CODE} in the environment) refuses what does not come with "
            "this package or an installed one; leave it out if you trust the file"
        )


class Command(NamedTuple):
    """A command of ``hil``, known without an import: the heading of ``hil --help`` below which it stands, the place
    ``package.module:name`` of a function or a ``typer.Typer``, and the first paragraph of its help.
    """

    task: str
    place: str
    text: str


@cache
def addon_commands() -> Mapping[str, Command]:
    """Return the commands of all add-ons that are installed, by name.

    An add-on is a package below ``hil/addons/`` with a table ``COMMANDS``, an entry point of the group ``hil.addons``;
    one whose folder has been removed brings nothing.
    """
    commands: dict[str, Command] = {}
    for package in Extensions("hil.addons").ours.values():
        commands |= import_module(package.value).COMMANDS
    return commands
