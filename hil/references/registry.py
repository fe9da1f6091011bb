"""From the kind of a reference in a scenario to a motion."""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, nearest
from hil.core.options import build
from hil.references.circle import Circle
from hil.references.figure_eight import FigureEight
from hil.references.hold import Hold
from hil.references.motion import ReferenceSource
from hil.references.rounded_square import RoundedSquare
from hil.references.spin import Spin
from hil.references.trajectory import Trajectory
from hil.references.waypoints import Waypoints

KINDS: dict[str, type[Any]] = {
    "circle": Circle,
    "hold": Hold,
    "figure_eight": FigureEight,
    "rounded_square": RoundedSquare,
    "spin": Spin,
    "waypoints": Waypoints,
    "trajectory": Trajectory,
}
"""By the name in a scenario: a dataclass of options, which is the motion itself or reads it from a file."""


def kinds() -> dict[str, str]:
    """Return the kinds, each with one line on what it is."""
    return {name: (inspect.getdoc(kind) or "").splitlines()[0] for name, kind in KINDS.items()}


def make_reference(kind: str, options: Mapping[str, object], directory: Path = Path()) -> ReferenceSource:
    """Return the reference of a scenario's ``[reference]`` table, ``options`` being the table without its
    kind.

    ``directory`` is where the path of a file starts from. Raises BadInputError for an unknown kind or option (with
    the nearest), a wrong type, a value out of range, and whatever is wrong with a file.
    """
    if kind not in KINDS:
        raise BadInputError(f"reference.kind = {kind!r}: unknown{nearest(kind, KINDS)}")
    made = build(KINDS[kind], options, "reference")
    source: ReferenceSource = made.read(directory) if isinstance(made, Waypoints | Trajectory) else made
    return source
