"""Finds the law that a scenario names, and makes the controller."""

import inspect
import sys
from collections.abc import Mapping
from dataclasses import asdict, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE, Extensions, from_package
from hil.core.model import RobotModel
from hil.core.options import build
from hil.core.strangers import check_may_run
from hil.core.types import CommandMode
from hil.laws.afdsc import Afdsc, AfdscCorrected, AfdscEso
from hil.laws.code import code_of_file, code_of_module, forget
from hil.laws.computed_torque import ComputedTorque
from hil.laws.dsc import Dsc, DscEso
from hil.laws.lqi import Lqi
from hil.laws.mpc import Mpc
from hil.laws.pid import Pid
from hil.laws.profile import Profile
from hil.laws.user import UserLaw, check_class, find_class

if TYPE_CHECKING:
    from hil.core.ports import Controller

SHIPPED: dict[str, type] = {
    "afdsc": Afdsc,
    "afdsc_corrected": AfdscCorrected,
    "afdsc_eso": AfdscEso,
    "computed_torque": ComputedTorque,
    "dsc": Dsc,
    "dsc_eso": DscEso,
    "lqi": Lqi,
    "mpc": Mpc,
    "pid": Pid,
    "profile": Profile,
}

_EXTENSIONS = Extensions("hil.laws", SHIPPED)
_LAW_KEY = "controller.law"

_given: dict[str, type] = {}  # classes passed to ``give_law``, by their name in scenarios of this process
_NO_OPTIONS = make_dataclass("Options", [])


def laws() -> list[tuple[str, str, str]]:
    """Return (name, package, description) of each law: the shipped ones, then those of other packages, not imported."""
    shipped = [(name, OUR_PACKAGE, (inspect.getdoc(law) or "").splitlines()[0]) for name, law in SHIPPED.items()]
    return shipped + _EXTENSIONS.lines()


def give_law(law: type) -> str:
    """Register a class and return a text for it that ``controller.law`` accepts in scenarios of this process."""
    shipped = [name for name, one in SHIPPED.items() if one is law]
    spec = shipped[0] if shipped else f"{law.__module__}:{law.__qualname__}"
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
    if spec in SHIPPED or spec in _given:
        return
    law = load_law(spec, base)
    for name in {law.__module__, _EXTENSIONS.module(spec) or law.__module__}:
        if not f"{name}.".startswith("hil."):
            sys.modules.pop(name, None)
            forget(name)


def law_sha256(spec: str, base: Path) -> str | None:
    """Return the hash of a law's code (see ``hil.laws.code``); None if its source is missing.

    ``spec`` and ``base`` are as for ``load_law``, but no errors are raised. The law's code is not executed.
    """
    if spec in SHIPPED:
        return code_of_module(SHIPPED[spec].__module__)
    location = _EXTENSIONS.module(spec)
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
    BadInputError as ``load_law`` and ``UserLaw`` do, for an option that is unknown (with similar names), of the wrong
    type or out of range, and for a mode that the law refuses.
    """
    law, named = _found(spec, base, law_key)
    kind: Any = getattr(law, "Options", None)
    checked = build(kind or _NO_OPTIONS, options, gains_key)
    if spec in SHIPPED:
        return cast("Controller", law(model, mode, checked))
    return UserLaw(named, law, mode, [(model, mode, checked)] if kind else [(model, mode), ()])


def gains_in_force(spec: str, base: Path, options: Mapping[str, object]) -> dict[str, object]:
    """Return every option of a law by name, defaults included. Raises as ``make_controller`` does."""
    kind: Any = getattr(load_law(spec, base), "Options", None)
    return asdict(build(kind or _NO_OPTIONS, options, "controller.gains"))


def _found(spec: str, base: Path, key: str) -> tuple[type, str]:
    """Return the law's class, and its name for error messages."""
    named = f"{key} = {spec!r}"
    if spec in SHIPPED:
        return SHIPPED[spec], named
    if spec in _given:
        return check_class(_given[spec], named), named
    if ":" in spec:
        check_may_run(named)
        return find_class(spec, base, named), named
    if spec.endswith(".py"):
        raise BadInputError(f"{named}: name the class too, as in '{spec}:MyLaw'")
    point = _EXTENSIONS.find(spec, named)
    named = from_package(named, point)
    return find_class(point.value, base, named), named
