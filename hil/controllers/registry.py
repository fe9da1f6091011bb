"""From the name of a law in a scenario to a controller that is ready to run."""

import inspect
from collections.abc import Mapping
from dataclasses import make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hil.controllers.afdsc import Afdsc
from hil.controllers.dsc import Dsc
from hil.controllers.profile import Profile
from hil.controllers.user import UserLaw, find_class
from hil.errors import BadInputError, nearest
from hil.model import RobotModel
from hil.options import build
from hil.types import CommandMode

if TYPE_CHECKING:
    from hil.ports import Controller

SHIPPED: dict[str, type] = {"afdsc": Afdsc, "dsc": Dsc, "profile": Profile}

_NO_OPTIONS = make_dataclass("Options", [])


def laws() -> dict[str, str]:
    """Return the shipped laws, each with one line on what it is."""
    return {name: (inspect.getdoc(law) or "").splitlines()[0] for name, law in SHIPPED.items()}


def load_law(spec: str, base: Path) -> type:
    """Return the class that a scenario's ``controller.law`` names.

    ``spec`` is a shipped name, ``"./my_law.py:MyLaw"`` (a file, relative to ``base``) or
    ``"package.module:MyLaw"``. Raises BadInputError for an unknown name (with the nearest), and as
    ``find_class`` does for a law of the user's.
    """
    if ":" in spec:
        return find_class(spec, base)
    if spec in SHIPPED:
        return SHIPPED[spec]
    if spec.endswith(".py"):
        raise BadInputError(f"controller.law = {spec!r}: name the class too, as in '{spec}:MyLaw'")
    raise BadInputError(f"controller.law = {spec!r}: unknown{nearest(spec, SHIPPED)}")


def make_controller(
    spec: str, base: Path, model: RobotModel, mode: CommandMode, options: Mapping[str, object]
) -> "Controller":
    """Return the controller of a scenario's ``[controller]`` table, ``options`` being ``[controller.gains]``.

    The law's dataclass ``Options`` defines them; the law is made as ``Law(model, mode, options)``. A law of
    the user's may have no ``Options``: it then takes none, and is made as ``Law(model, mode)``, or as
    ``Law()`` when it has no constructor. Raises BadInputError as ``load_law`` and ``UserLaw`` do, and for an
    option that is unknown (with the nearest), of the wrong type or out of range.
    """
    law = load_law(spec, base)
    kind: Any = getattr(law, "Options", None)
    checked = build(kind or _NO_OPTIONS, options, "controller.gains")
    if spec in SHIPPED:
        return cast("Controller", law(model, mode, checked))
    return UserLaw(spec, law, mode, [(model, mode, checked)] if kind else [(model, mode), ()])
