"""Finds the law that a scenario names, and makes the controller."""

import inspect
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE, Extensions, check_may_run, from_package
from hil.core.model import RobotModel
from hil.core.options import build
from hil.core.types import CommandMode

if TYPE_CHECKING:
    from hil.core.ports import Controller

LAWS = Extensions("hil.laws")
_LAW_KEY = "controller.law"

_given: dict[str, type] = {}  # classes passed to ``give_law``, by their name in scenarios of this process
_NO_OPTIONS = make_dataclass("Options", [])


def shipped_laws() -> dict[str, type]:
    """Import and return the shipped laws by name."""
    return {name: LAWS.load(name, f"{_LAW_KEY} = {name!r}") for name in LAWS.shipped}


def laws() -> list[tuple[str, str, str]]:
    """Return (name, package, description) of each law: the shipped ones, then those of other packages, not imported."""
    shipped = ((name, OUR_PACKAGE, (inspect.getdoc(law) or "").splitlines()[0]) for name, law in shipped_laws().items())
    return [*shipped, *LAWS.lines()]


def short_name(spec: str) -> str:
    """Return the prefix of a law's signals: its name, or the class name of a law like ``./my_law.py:MyLaw``."""
    return re.sub(r"\W", "_", spec.rpartition(":")[2])


def law_file(spec: str) -> str | None:
    """Return the file of a law like ``./my_law.py:MyLaw``, None for any other."""
    location = spec.rpartition(":")[0]
    return location if location.endswith(".py") else None


def give_law(law: type) -> str:
    """Register a class and return a text for it that ``controller.law`` accepts in scenarios of this process."""
    spec = f"{law.__module__}:{law.__qualname__}"
    spec = next((name for name, point in LAWS.ours.items() if point.value == spec), spec)
    _given[spec] = law
    return spec


def load_law(spec: str, base: Path) -> type:
    """Return the class that a scenario's ``controller.law`` names.

    ``spec`` is a shipped name, one that an installed package has registered as an entry point of the group
    ``hil.laws``, ``"./my_law.py:MyLaw"`` (a file, relative to ``base``) or ``"package.module:MyLaw"``. Raises
    BadInputError for an unknown name (with similar ones), for one that two packages have registered, and as
    ``find_class`` does for a law of the user.
    """
    return _found(spec, base, _LAW_KEY)[0]


def forget_law(spec: str, base: Path) -> None:
    """Make the next load of a law execute its module again, so that no module state is left from an earlier run.

    The module of a law in a file is always executed again; modules that it imports are not. Raises as ``load_law``.
    """
    if LAWS.is_shipped(spec) or spec in _given:
        return
    from hil.laws.code import forget

    law = load_law(spec, base)
    for name in {law.__module__, LAWS.module(spec) or law.__module__}:
        if not f"{name}.".startswith("hil."):
            sys.modules.pop(name, None)
            forget(name)


def law_sha256(spec: str, base: Path) -> str | None:
    """Return the hash of a law's code (see ``hil.laws.code``); None if its source is missing.

    ``spec`` and ``base`` are as for ``load_law``, but no errors are raised. The law's code is not executed.
    """
    from hil.laws.code import code_of_file, code_of_module

    if LAWS.is_shipped(spec):
        return code_of_module(LAWS.find(spec, _LAW_KEY).module)
    location = LAWS.module(spec)
    if location is None:
        return None
    return code_of_file(base / location) if location.endswith(".py") else code_of_module(location)


def make_controller(
    spec: str,
    base: Path,
    model: RobotModel,
    mode: CommandMode,
    options: Mapping[str, object],
    *,
    law_key: str = _LAW_KEY,
    gains_key: str = "controller.gains",
) -> "Controller":
    """Return the controller of a scenario's ``[controller]`` table, ``options`` being ``[controller.gains]``.

    ``law_key`` and ``gains_key`` name the two in error messages.

    The law's dataclass ``Options`` defines the options; the law is made as ``Law(model, mode, options)``. A user's law
    without ``Options`` has none; it is made as ``Law(model, mode)``, or as ``Law()`` if it has no constructor. Raises
    BadInputError as ``load_law`` and ``UserLaw`` do, for a wrong option (with similar names if it is unknown), and for
    a mode that the law refuses.
    """
    law, named = _found(spec, base, law_key)
    kind: Any = getattr(law, "Options", None)
    checked = build(kind or _NO_OPTIONS, options, gains_key)
    if LAWS.is_shipped(spec):
        return cast("Controller", law(model, mode, checked))
    from hil.laws.user import UserLaw

    return UserLaw(named, law, mode, [(model, mode, checked)] if kind else [(model, mode), ()])


def gains_in_force(spec: str, base: Path, options: Mapping[str, object]) -> dict[str, object]:
    """Return every option of a law by name, defaults included. Raises as ``make_controller`` does."""
    kind: Any = getattr(load_law(spec, base), "Options", None)
    return asdict(build(kind or _NO_OPTIONS, options, "controller.gains"))


def _found(spec: str, base: Path, key: str) -> tuple[type, str]:
    """Return the law's class, and its name for error messages."""
    named = f"{key} = {spec!r}"
    if LAWS.is_shipped(spec):
        return LAWS.load(spec, named), named
    from hil.laws.user import check_class, find_class

    if spec in _given:
        return check_class(_given[spec], named), named
    if ":" in spec:
        check_may_run(named)
        return find_class(spec, base, named), named
    if spec.endswith(".py"):
        raise BadInputError(f"{named}: name the class too, as in '{spec}:MyLaw'")
    point = LAWS.find(spec, named)
    named = from_package(named, point)
    return find_class(point.value, base, named), named
