"""Laws of users and other packages: finds the class, and turns every exception of its code into a BadInputError."""

import importlib
import importlib.util
import inspect
import re
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from hil.core.errors import BadInputError, nearest
from hil.core.extensions import failure, failures_of
from hil.core.signals import GROUPS
from hil.core.tuples import make_command, make_wheels
from hil.core.types import NO_GAINS, Applied, CommandMode, Gains, Reference, State, WheelCommand
from hil.laws.law_registry import law_file

_METHODS = {"reset": ("self", "state", "reference"), "update": ("self", "reference", "state", "applied", "dt_s")}
_SIGNAL = re.compile(r"[a-z][a-z0-9_]*(\.[a-z0-9_]+)+")
_RESERVED = GROUPS | {"replay", "timestamp", "sequence"}


def find_class(spec: str, base: Path, named: str) -> type:
    """Return the class named by ``"./my_law.py:MyLaw"`` (relative to ``base``) or ``"package.module:MyLaw"``.

    Error messages begin with ``named``. Raises BadInputError when there is no such file, module or class, when the
    import fails (with file and line), and when the class lacks ``reset`` or ``update`` or they have other arguments.
    """
    location, _, name = spec.rpartition(":")
    file = law_file(spec)
    module = _import_file(named, base / file) if file else _import_module(named, location)
    law = getattr(module, name, None)
    if not isinstance(law, type):
        own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
        hint = nearest(name, [v.__name__ for v in own]) or "; it has none"
        raise BadInputError(f"{named}: no class {name!r} in {location}{hint}")
    return check_class(law, named)


def check_class(law: type, named: str) -> type:
    """Return the class if it can be a law. Raises BadInputError as ``find_class``; messages begin with ``named``."""
    for method, arguments in _METHODS.items():
        expected = f"{method}({', '.join(arguments)})"
        function = getattr(law, method, None)
        if not callable(function):
            raise BadInputError(f"{named}: the class has no {method}; expected {expected}")
        if not _accepts(function, arguments):
            raise BadInputError(f"{named}: found {method}{_signature(function)}, expected {expected}")
    return law


class UserLaw:
    """A controller around a user's law.

    The law is made with the first of the argument lists ``choices`` that its constructor accepts. It need not have
    ``gains``, nor ``signals`` and ``telemetry`` (``hil.core.ports.OwnSignals``). Error messages begin with ``named``.
    Raises BadInputError, with file and line, for every exception of the law, and when its update does not return a
    command in the mode of the run. ``signals_may_fail`` says whether the law has gains or signals of its own, whose
    code may fail too.
    """

    def __init__(self, named: str, law: type, mode: CommandMode, choices: list[tuple[object, ...]]) -> None:
        self._named = named
        self._mode = mode
        arguments = _constructor_arguments(named, law, choices)
        with failures_of(named, "making it"):
            self._law: Any = law(*arguments)
        self._has_gains = inspect.getattr_static(self._law, "gains", None) is not None
        self.signals = self._own_names()
        self.signals_may_fail = self._has_gains or bool(self.signals)

    @property
    def gains(self) -> Gains:
        """The law's gains, or NO_GAINS."""
        if not self._has_gains:
            return NO_GAINS
        with failures_of(self._named, "gains"):
            return Gains(*map(float, self._law.gains))

    @property
    def telemetry(self) -> tuple[float, ...]:
        """The values of the law's own signals."""
        with failures_of(self._named, "telemetry"):
            values = tuple(map(float, self._law.telemetry))
        if len(values) != len(self.signals):
            raise BadInputError(f"{self._named}: telemetry has {len(values)} values for {len(self.signals)} signals")
        return values

    def reset(self, state: State, reference: Reference) -> None:
        """Reset the user's law."""
        with failures_of(self._named, "reset"):
            self._law.reset(state, reference)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Update the user's law; check and return its command."""
        try:  # not failures_of: a context manager takes as long as a law
            command = self._law.update(reference, state, applied, dt_s)
        except BadInputError:
            raise
        except (Exception, SystemExit) as error:
            raise failure(self._named, "update", error) from error
        if not isinstance(command, WheelCommand):
            raise BadInputError(f"{self._named}: update returned {command!r}, expected a WheelCommand")
        if command.mode != self._mode:
            raise BadInputError(
                f"{self._named}: update returned a command of mode {_mode_name(command.mode)}, "
                f"expected {self._mode.name}, the mode that it was made with"
            )
        try:
            fl, fr, rr, rl = map(float, command.speed_rad_s)
            speed = make_wheels(fl, fr, rr, rl)
            fl, fr, rr, rl = map(float, command.torque_n_m)
        except (TypeError, ValueError) as error:
            raise BadInputError(
                f"{self._named}: update returned {command!r}, expected four numbers in speed_rad_s and four in "
                f"torque_n_m ({error})"
            ) from error
        return make_command(command.mode, speed, make_wheels(fl, fr, rr, rl))

    def _own_names(self) -> tuple[str, ...]:
        has = [name for name in ("signals", "telemetry") if inspect.getattr_static(self._law, name, None) is not None]
        if not has:
            return ()
        if len(has) == 1:
            raise BadInputError(f"{self._named}: it has {has[0]} alone; signals of its own take signals and telemetry")
        with failures_of(self._named, "signals"):
            names = self._law.signals
        if not isinstance(names, list | tuple):
            raise BadInputError(f"{self._named}: signals is {names!r}, expected a tuple of names")
        return _check_names(self._named, names)


def _check_names(named: str, names: Sequence[object]) -> tuple[str, ...]:
    """Check and return the names of a law's own signals; error messages begin with ``named``.

    Raises BadInputError for a name that is not dotted lower case, is repeated, is a group of another (``a.b`` and
    ``a.b.c``), or begins with a reserved group, such as a built-in one.
    """
    checked: list[str] = []
    for name in names:
        begin = f"{named}: signals has {name!r}"
        if not isinstance(name, str) or not _SIGNAL.fullmatch(name):
            raise BadInputError(f"{begin}; expected dotted names in lower case, such as 'observer.x_m_s2'")
        group = name.partition(".")[0]
        if group in _RESERVED:
            raise BadInputError(f"{begin}; {group!r} is reserved, begin the name with another word")
        for other in checked:
            if name == other:
                raise BadInputError(f"{begin} twice; name each once")
            if name.startswith(f"{other}.") or other.startswith(f"{name}."):
                raise BadInputError(f"{begin} and {other!r}; neither may be a group of the other")
        checked.append(name)
    return tuple(checked)


def _import_file(named: str, path: Path) -> ModuleType:
    if not path.is_file():
        raise BadInputError(f"{named}: no file {path} (relative to the scenario's folder)")
    # A unique name: a user's file called random.py or dsc.py must not replace another module.
    name = f"_law_{path.stem}_{zlib.crc32(str(path.resolve()).encode()):08x}"
    description = importlib.util.spec_from_file_location(name, path)
    assert description is not None  # because its name ends in .py
    assert description.loader is not None
    module = importlib.util.module_from_spec(description)
    # Dataclasses look up their module there during the import.
    sys.modules[name] = module
    try:
        with failures_of(named, "importing it"):
            description.loader.exec_module(module)
    except BadInputError:
        del sys.modules[name]
        raise
    return module


def _import_module(named: str, name: str) -> ModuleType:
    with failures_of(named, "importing it"):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            # Only if the requested module or a package around it is missing, not one that it imports.
            if error.name and (name == error.name or name.startswith(f"{error.name}.")):
                raise BadInputError(
                    f"{named}: no module {error.name!r}; install it, or name a file as in './my_law.py:MyLaw'"
                ) from error
            raise


def _constructor_arguments(named: str, law: type, choices: list[tuple[object, ...]]) -> tuple[object, ...]:
    names = ", ".join(("self", "model", "mode", "options")[: 1 + len(choices[0])])
    for arguments in choices:
        if _accepts(law, arguments):
            return arguments
    hint = "" if len(choices[0]) == 3 else "; for options, define a dataclass Options in the class"
    raise BadInputError(f"{named}: found {law.__name__}{_signature(law)}, expected __init__({names}){hint}")


def _signature(function: Any) -> inspect.Signature:
    """Return the signature of a function; any arguments for one of compiled code, which may not have it."""
    try:
        return inspect.signature(function)
    except ValueError:
        return inspect.signature(lambda *_: None)


def _accepts(function: Any, arguments: tuple[object, ...]) -> bool:
    try:
        _signature(function).bind(*arguments)
    except TypeError:
        return False
    return True


def _mode_name(mode: object) -> str:
    return mode.name if isinstance(mode, CommandMode) else repr(mode)
