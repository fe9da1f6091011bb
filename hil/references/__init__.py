"""Where the robot should be, as pure functions of the scenario's time (REFERENCES.md).

May import: `core`.
To add a kind of reference: one file here and a row in `registry.py`; from another package an entry point of the group
`hil.references`.
"""

from hil.references.feasibility import Feasibility, feasibility
from hil.references.motion import ReferenceSource
from hil.references.registry import SHIPPED, make_reference, reference_module, references

__all__ = [
    "SHIPPED",
    "Feasibility",
    "ReferenceSource",
    "feasibility",
    "make_reference",
    "reference_module",
    "references",
]
