"""What a kind of fault is, and a row of ``[[fault]]`` as numbers for the code that applies it."""

import math
import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from hil.core.errors import nearest
from hil.core.options import Range, in_another_unit
from hil.core.signals import SIGNAL_NAMES

NS_PER_S = 1_000_000_000
NEVER_NS = 2**62
REST_RAD_S = 0.2
"""The default speed of a wheel below which a robot is at rest: 15 mm/s at the rim of a wheel of 75 mm."""


class FaultRow(NamedTuple):
    """A row of ``[[fault]]`` as numbers; those that its kind does not have are 0.

    It is in force while start_ns <= t < end_ns, in the scenario's time.
    """

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
        """Return whether the row is in force at this time."""
        return self.start_ns <= t_ns < self.end_ns


def claimed_span_s(claim: Mapping[str, Any], faults: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Return from when to when a row of ``[[expect]]`` is judged; both tables as plain values, None or left out alike.

    ``after_fault`` names a fault by its name, by its kind if only one row has that, or by its row, from 1. A robot that
    is at rest while a fault lasts may drive again after it, so ``at_rest`` ends with a fault that still lasts when the
    claim begins. A claim that the robot ``stops`` is from the fault's begin on, for ``within_s``. Raises
    ValueError, with part of a message, when there is no such fault or more than one.
    """
    which, to_s = claim.get("after_fault"), float(claim.get("to_s", math.inf))
    if which is None:
        return float(claim.get("from_s", 0.0)), to_s
    fault = _named(which, faults)
    start_s = float(fault.get("start_s", 0.0))
    from_s = start_s + float(claim.get("within_s") or 0.0)
    if claim.get("stops"):
        return start_s, min(to_s, from_s)
    end_s = float(fault.get("end_s", math.inf))
    return from_s, min(to_s, end_s) if claim.get("at_rest") and end_s > from_s else to_s


def _named(which: int | str, faults: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    if not faults:
        raise ValueError("the scenario has no fault; add a row of [[fault]], or give from_s")
    if isinstance(which, int):
        if not 1 <= which <= len(faults):
            raise ValueError(f"expected a row from 1 to {len(faults)}: the scenario has {len(faults)} of them")
        return faults[which - 1]
    found = [row for row in faults if row.get("name") == which] or [row for row in faults if row["kind"] == which]
    if not found:
        known = [row.get("name") or row["kind"] for row in faults]
        raise ValueError(f"no fault has this name or kind{nearest(which, known)}")
    if len(found) > 1:
        raise ValueError(f'{len(found)} faults are of this kind; name one of them, as in name = "first {which}"')
    return found[0]


def generators(rows: Sequence[FaultRow], seed: int) -> list[random.Random]:
    """Return a random generator for each row, seeded by ``seed`` and by what the row says.

    So removing a row does not change the random numbers of the others. Equal rows get different generators.
    """
    seen: dict[FaultRow, int] = {}
    sources = []
    for row in rows:
        seen[row] = seen.get(row, -1) + 1
        sources.append(random.Random(f"{seed} {tuple(row)} {seen[row]}"))
    return sources


SignalEffect: TypeAlias = Callable[[float, int], float]
"""Takes a signal's value and the scenario's time [ns] inside the window; returns the value that is seen instead."""
FrameEffect: TypeAlias = Callable[[str, list[Frame]], list[Frame]]
"""Takes a direction, "command" or "feedback", and a list of a frame's copies, which stays; returns what to pass on."""


class Quantity(NamedTuple):
    """A number of a row: its name, unit, range and default; None if the row must give it."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    default: float | None = None
    excludes_low: bool = False

    @property
    def range(self) -> str:
        """The range in words."""
        if self.low == -self.high:
            return f"-{self.high:g} to {self.high:g}"
        return (
            f"more than {self.low:g}, at most {self.high:g}" if self.excludes_low else f"{self.low:g} to {self.high:g}"
        )

    def holds(self, value: float) -> bool:
        """Tell whether a value is in range."""
        return self.low <= value <= self.high and not (self.excludes_low and value == self.low)


class Kind(NamedTuple):
    """A kind of fault.

    Attributes:
        acts_on: "link", "device", "plant" or "signal".
        targets: the targets that a row may name; empty where only the FMU knows them.
        target_words: the targets in words, for the page.
        meaning: what happens.
        counts: what the number ``applied`` in reports counts.
        example: the rest of a row, for the page.
        value: the row's ``value``, None for a kind without one.
        further: its other numbers, of which a row gives all or none.
        is_instant: it happens at start_s and has no end.
        explains: it can interrupt feedback, state or robot, so ticks in which the robot is not driven are put down to
            it.
        on_signal: for a kind that changes a value: called as ``on_signal(row, chance)`` once for each row, returns its
            effect. ``applied`` then counts the changed values.
        on_frames: the same for a kind that loses, doubles or replaces frames.
    """

    name: str
    acts_on: str
    targets: tuple[str, ...]
    target_words: str
    meaning: str
    counts: str
    example: Mapping[str, str | float]
    value: Quantity | None = None
    further: tuple[Quantity, ...] = ()
    is_instant: bool = False
    explains: bool = False
    on_signal: Callable[[FaultRow, random.Random], SignalEffect] | None = None
    on_frames: Callable[[FaultRow, random.Random], FrameEffect] | None = None

    @property
    def unit(self) -> str:
        """The unit of ``value`` in words."""
        return "-" if self.value is None else self.value.unit or self.value.meaning

    def check_target(self, target: str, value: float | None) -> None:
        """Raise ValueError, with part of a message, unless the kind acts on the target.

        Whether the run has a signal of this name is checked with the scenario.
        """
        if self.acts_on == "signal":
            if target in SIGNAL_NAMES and target not in self.targets:
                raise ValueError(f"target = {target!r} is not a target of {self.name}; it is the time of the run")
        elif self.targets and target not in self.targets:
            expected = f"; expected {self.target_words.replace('`', '')}" if len(self.targets) > 12 else None
            hint = nearest(target, self.targets, expected)
            raise ValueError(f"target = {target!r} is not a target of {self.name}{hint}")
        if target == "robot.state" and self.name == "bias":
            raise ValueError("target = 'robot.state' is not a quantity; use override with the number of a state")
        if target == "robot.state" and self.name == "override" and value not in list(State):
            known = ", ".join(f"{state.value} {state.name}" for state in State)
            raise ValueError(f"value = {value} is not a state of the firmware; expected one of {known}")

    def check_numbers(self, given: Mapping[str, float | None]) -> None:
        """Raise ValueError, with part of a message, unless a row's numbers fit the kind; None: not given."""
        known = {q.name: q for q in (self.value, *self.further) if q is not None}
        for name, value in given.items():
            quantity = known.get(name)
            if quantity is None:
                if value is not None:
                    raise ValueError(f"{name} = {value:g}: {self.name} takes no {name}; remove it")
            elif value is not None and not quantity.holds(value):
                unit = f" {quantity.unit}" if quantity.unit else ""
                hint = in_another_unit(f"value_{quantity.unit}", value, Range(ge=quantity.low, le=quantity.high))
                raise ValueError(f"{name} = {value:g}: expected {quantity.range}{unit}, the {quantity.meaning}{hint}")
        if self.value is not None and given["value"] is None:
            raise ValueError(f"value is missing: {self.value.meaning}, {self.value.range} {self.value.unit}".rstrip())
        further = [quantity.name for quantity in self.further]
        if len({given[name] is None for name in further}) > 1:
            raise ValueError(f"{', '.join(further)} belong together; give all or none")
        share, burst = given["value"], given["burst_frames"]
        if self.name == "burst_loss" and share is not None and burst is not None and share > burst / (burst + 1.0):
            raise ValueError(
                f"value = {share:g}: bursts of {burst:g} frames with one whole frame between them lose "
                f"{burst / (burst + 1.0):.3g}; lower value, or raise burst_frames"
            )
