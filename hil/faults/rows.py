"""A row of ``[[fault]]``: what it says to those that apply it, whether that fits its kind, and its chance.

A row names a kind and a target. Its window is start_s <= t < end_s in the scenario's time, by default the whole run.
Chance comes from loop.seed and from what the row says, so that each row has numbers of its own and removing one
changes no other.
"""

import random
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.core.errors import nearest
from hil.core.signals import SIGNAL_NAMES
from hil.faults.kinds import KINDS, Kind

NS_PER_S = 1_000_000_000
NEVER_NS = 2**62


class FaultRow(NamedTuple):
    """A row as what applies it needs it: times in ns of the scenario's time; a number that its kind has not is 0."""

    kind: str
    acts_on: str
    target: str
    start_ns: int
    end_ns: int
    value: float = 0.0
    burst_frames: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    radius_m: float = 0.0

    def is_in_force(self, t_ns: int) -> bool:
        """Tell whether a time is in the window."""
        return self.start_ns <= t_ns < self.end_ns


def generators(rows: Sequence[FaultRow], seed: int) -> list[random.Random]:
    """Return a source of chance for each row; equal rows get different ones."""
    seen: dict[FaultRow, int] = {}
    sources = []
    for row in rows:
        seen[row] = seen.get(row, -1) + 1
        sources.append(random.Random(f"{seed} {tuple(row)} {seen[row]}"))
    return sources


def find(name: str, target: str | None) -> Kind:
    """Return the kind of a row. Raises ValueError with part of a sentence when there is none of this name."""
    kinds = [kind for kind in KINDS if kind.name == name]
    if not kinds:
        raise ValueError(f"kind = {name!r} is no kind of fault{nearest(name, names())}")
    return next((kind for kind in kinds if target in kind.targets), kinds[-1])


def names() -> tuple[str, ...]:
    """Return the names of the kinds, each once."""
    return tuple(dict.fromkeys(kind.name for kind in KINDS))


def check_target(kind: Kind, target: str, value: float | None) -> None:
    """Raise ValueError with part of a sentence unless the kind acts on the target.

    Of a signal's name only the scenario knows whether the run has it.
    """
    if kind.acts_on == "signal":
        if target in SIGNAL_NAMES and target not in kind.targets:
            raise ValueError(f"target = {target!r} is nothing that {kind.name} acts on; it is the time of the run")
    elif kind.targets and target not in kind.targets:
        hint = nearest(target, kind.targets)
        if "did you mean" not in hint and len(kind.targets) > 12:
            hint = f"; expected {kind.target_words.replace('`', '')}"
        raise ValueError(f"target = {target!r} is nothing that {kind.name} acts on{hint}")
    if target == "robot.state" and kind.name == "bias":
        raise ValueError("target = 'robot.state' is no quantity; use override with the number of a state")
    if target == "robot.state" and kind.name == "override" and value not in list(State):
        known = ", ".join(f"{state.value} {state.name}" for state in State)
        raise ValueError(f"value = {value} is no state of the firmware; expected one of {known}")


def check_numbers(kind: Kind, given: Mapping[str, float | None]) -> None:
    """Raise ValueError with part of a sentence unless a row's numbers fit its kind. ``given`` has None for no value."""
    known = {q.name: q for q in (kind.value, *kind.further) if q is not None}
    for name, value in given.items():
        quantity = known.get(name)
        if quantity is None:
            if value is not None:
                raise ValueError(f"{name} = {value:g}: {kind.name} takes no {name}; remove it")
        elif value is not None and not quantity.holds(value):
            unit = f" {quantity.unit}" if quantity.unit else ""
            raise ValueError(f"{name} = {value:g}: expected {quantity.range}{unit}, the {quantity.meaning}")
    if kind.value is not None and given["value"] is None:
        raise ValueError(f"value is missing: {kind.value.meaning}, {kind.value.range} {kind.value.unit}".rstrip())
    further = [quantity.name for quantity in kind.further]
    if len({given[name] is None for name in further}) > 1:
        raise ValueError(f"{', '.join(further)} belong together; give all or none")
    share, burst = given["value"], given["burst_frames"]
    if kind.name == "burst_loss" and share is not None and burst is not None and share > burst / (burst + 1.0):
        raise ValueError(
            f"value = {share:g}: bursts of {burst:g} frames with one whole frame between them lose "
            f"{burst / (burst + 1.0):.3g}; lower value, or raise burst_frames"
        )
