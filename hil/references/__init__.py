"""Where the robot should be, as pure functions of the scenario's time (REFERENCES.md).

May import: `core`.
To add a kind of reference: one file here and a row in `registry.py`; from another package an entry point of the group
`hil.references`.
"""

from hil.references.circle import Circle
from hil.references.feasibility import Feasibility, feasibility
from hil.references.figure_eight import FigureEight
from hil.references.hold import Hold
from hil.references.motion import ReferenceSource
from hil.references.registry import SHIPPED, make_reference, reference_module, references
from hil.references.rounded_square import RoundedSquare
from hil.references.spin import Spin
from hil.references.trajectory import Trajectory
from hil.references.waypoints import Waypoints

__all__ = [
    "SHIPPED",
    "Circle",
    "Feasibility",
    "FigureEight",
    "Hold",
    "ReferenceSource",
    "RoundedSquare",
    "Spin",
    "Trajectory",
    "Waypoints",
    "feasibility",
    "make_reference",
    "reference_module",
    "references",
]
