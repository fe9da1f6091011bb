"""The tables that make a scenario a test: ``[[fault]]``, ``[[expect]]`` and ``[allow]``."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated, Any

from hil.core.options import Expected, OptionsError, Problem, Range, plain
from hil.faults.rows import NEVER_NS, NS_PER_S, REST_RAD_S, FaultRow, claimed_span_s
from hil.scenario.values import Text

if TYPE_CHECKING:
    from hil.faults.kinds import Kind

_NUMBERS = ("value", "burst_frames", "x_m", "y_m", "radius_m")
_SHARE = re.compile(r"(\d+(?:\.\d+)?) ?%")


def _kinds() -> str:
    from hil.faults.kinds import names

    return f"a kind of fault, one of {', '.join(names())}"


@dataclass(frozen=True)
class FaultTable:
    """``[[fault]]``: one fault in start_s <= t < end_s of the scenario's time; hil/faults/FAULTS.md has every kind."""

    kind: Annotated[Text, Expected(_kinds), "`hil list faults` prints all"]
    target: Annotated[Text, "what it acts on; may be left out if the kind has only one target"] = ""
    start_s: Annotated[float, Range(ge=0, le=1000000.0)] = 0.0
    end_s: Annotated[float, Range(gt=0, infinite=True)] = math.inf
    name: Annotated[str | None, "by which an expectation names it, if there are several of a kind"] = None
    value: Annotated[float | None, "size of the fault, in the unit of its kind"] = None
    burst_frames: Annotated[float | None, "of burst_loss: mean length of a burst"] = None
    x_m: Annotated[
        float | None, "of slip_patch: centre of the circle, world frame; of payload: ahead of the robot's centre"
    ] = None
    y_m: Annotated[float | None, "of slip_patch: centre of the circle, world frame; of payload: to the left of it"] = (
        None
    )
    radius_m: Annotated[float | None, "of slip_patch: radius of the circle"] = None

    def __post_init__(self) -> None:
        """Fill in the defaults of the kind; raise ValueError for values that the kind does not take."""
        from hil.faults.kinds import find  # only for a scenario with faults

        kind = find(self.kind, self.target or None)
        defaults: dict[str, Any] = {
            quantity.name: quantity.default for quantity in (kind.value, *kind.further) if quantity is not None
        }
        if len(kind.targets) == 1:
            defaults["target"] = kind.targets[0]
        for name, default in defaults.items():
            if getattr(self, name) in (None, ""):
                object.__setattr__(self, name, default)
        if not self.target:
            expected = f"expected what {self.kind} acts on: {kind.target_words.replace('`', '')}"
            raise OptionsError([Problem(("target",), "missing", expected)])
        kind = find(self.kind, self.target)
        kind.check(self.target, {name: getattr(self, name) for name in _NUMBERS})
        if kind.is_instant and self.end_s != math.inf:
            raise ValueError(f"end_s = {self.end_s}: {kind.name} happens at start_s and has no end; remove end_s")
        if self.end_s <= self.start_s:
            raise ValueError(f"end_s = {self.end_s} is not after start_s = {self.start_s}")

    @property
    def row(self) -> FaultRow:
        """The row as numbers, for the code that applies it."""
        return FaultRow(
            self.kind,
            self._of_kind.acts_on,
            self.target,
            round(self.start_s * NS_PER_S),
            NEVER_NS if self.end_s > 1e9 else round(self.end_s * NS_PER_S),
            *(0.0 if (value := getattr(self, name)) is None else float(value) for name in _NUMBERS),
        )

    @property
    def _of_kind(self) -> "Kind":
        from hil.faults.kinds import find

        return find(self.kind, self.target)

    @property
    def counts(self) -> str:
        """The unit of the count of this fault in a report."""
        return self._of_kind.counts

    @property
    def is_instant(self) -> bool:
        """Whether it only happens, at its start."""
        return self._of_kind.is_instant

    @property
    def words(self) -> str:
        """The row in a few words, for reports."""
        end = "" if self.end_s == math.inf else f" to {self.end_s:g} s"
        value = "" if self.value is None else f" {self.value:g}"
        return f"{self.kind} {self.target}{value} from {self.start_s:g} s{end}"


def _share(value: object) -> float | str | None:
    """Accept a number of at least 0, or a share as text; None is no value."""
    if value is None or (isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < math.inf):
        return value
    if isinstance(value, str) and _SHARE.fullmatch(value) is not None:
        return value
    raise ValueError('expected a share such as "10%", or a number of at least 0 in the unit of the figure')


def _which_fault(value: object) -> int | str | None:
    """Accept the name or kind of a fault, or its row; None is no value."""
    if value is None or (isinstance(value, str) and value):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
        return value
    raise ValueError("expected the name of a fault, its kind, or its row in the scenario, from 1")


_SUBJECTS = "`signal`, `figure`, `at_rest = true`, or `stops`"
_CLAIMS = ("within", "equals", "settles_to", "baseline")


@dataclass(frozen=True)
class ExpectTable:
    """``[[expect]]``: a claim about a signal in from_s <= t <= to_s of the run, a figure of it, rest, or a stop.

    A signal: ``below``, ``above`` or both; ``within`` = [low, high], both included; ``equals`` with a ``tolerance``;
    ``settles_to``: from some time on it stays within the ``tolerance``. With ``of``: the signal minus that one.

    A figure of the whole run: the same claims but ``settles_to``; or ``baseline``, how far it may be from that value.

    ``at_rest``: no wheel turns faster than ``below``, and the true pose does not move faster than such wheels would
    move it, where either is known. ``stops``: the robot stops on its own, for this reason; the run goes on.

    ``after_fault`` with ``within_s`` replaces ``from_s``: the claim begins ``within_s`` after that fault has begun.
    ``at_rest`` ends with the fault, if that still lasts then. ``stops`` is within this time of the fault's begin.
    """

    signal: Annotated[
        str | None,
        Expected("the name of a signal; `hil list signals` prints them all"),
        "dotted name of a built-in signal, or of a signal of the law",
    ] = None
    of: Annotated[str | None, "name of the signal with which the first is compared; the claim is on the difference"] = (
        None
    )
    figure: Annotated[str | None, "name of a figure of the run; `hil list figures` prints them all"] = None
    at_rest: Annotated[bool | None, "true: the claim is that the robot is at rest"] = None
    stops: Annotated[str | None, "part of the reason that the robot gives, such as OVERSPEED or COMMAND_TIMEOUT"] = None
    after_fault: Annotated[Any, _which_fault, "name, kind or row (from 1) of the fault after which it is judged"] = None
    within_s: Annotated[float | None, Range(ge=0), "time after the beginning of that fault"] = None
    from_s: Annotated[float, Range(ge=0)] = 0.0
    to_s: Annotated[float, Range(gt=0, infinite=True)] = math.inf
    below: float | None = None
    above: float | None = None
    within: Annotated[tuple[float, float] | None, "lowest and highest value that pass"] = None
    equals: float | None = None
    settles_to: float | None = None
    tolerance: Annotated[float | None, Range(ge=0), "of equals (by default 0) and settles_to"] = None
    baseline: Annotated[Any, _share, 'of a figure: how far from the baseline, as "10%" of it or in its unit'] = None

    def __post_init__(self) -> None:
        subjects = (self.signal is not None, self.figure is not None, bool(self.at_rest), self.stops is not None)
        if sum(subjects) != 1:
            raise ValueError(f"needs one of {_SUBJECTS}")
        if self.signal is None and self.of is not None:
            raise ValueError(f"of = {self.of!r} is compared with a signal; name it with signal, or remove of")
        if self.figure is not None:
            self._check_figure()
        elif self.baseline is not None:
            raise ValueError(f"baseline = {self.baseline!r} is for a figure; name it with figure")
        if (self.after_fault is None) != (self.within_s is None):
            raise ValueError("after_fault and within_s belong together: after which fault, and by when; give both")
        if self.after_fault is not None and self.from_s:
            raise ValueError("after_fault says from when it is judged; remove from_s")
        self._check_claim()
        if self.to_s < self.from_s:
            raise ValueError(f"to_s = {self.to_s} is before from_s = {self.from_s}")

    def _check_figure(self) -> None:
        if self.from_s or self.to_s != math.inf or self.after_fault is not None or self.settles_to is not None:
            raise ValueError(
                f"the figure {self.figure!r} is one number of the whole run; it takes below, above, within, equals or "
                "baseline, and no time"
            )

    def _check_claim(self) -> None:
        bounds = self.below is not None or self.above is not None
        claims = [name for name in _CLAIMS if getattr(self, name) is not None]
        if self.stops is not None:
            if bounds or claims or self.tolerance is not None:
                raise ValueError(f"stops = {self.stops!r} is a claim of its own; it takes a time and no further claim")
            if not self.stops.strip():
                raise ValueError("stops is empty; expected part of the reason, such as OVERSPEED")
            return
        if self.at_rest:
            if self.above is not None or claims or self.tolerance is not None:
                raise ValueError(
                    f"at_rest takes no claim but below, the speed of a wheel at rest, by default {REST_RAD_S:g} rad/s"
                )
            if self.below is None:
                object.__setattr__(self, "below", REST_RAD_S)
            return
        if bounds + len(claims) != 1:
            more = ", or baseline" if self.figure is not None else ", or settles_to"
            raise ValueError(f"needs one claim: below or above or both, within, equals{more}")
        if self.below is not None and self.above is not None and self.above >= self.below:
            raise ValueError(f"above = {self.above} is not less than below = {self.below}: no value can pass")
        if self.within is not None and self.within[0] > self.within[1]:
            raise ValueError(f"within = {list(self.within)}: the first is more than the second; give [low, high]")
        if self.tolerance is not None and self.equals is None and self.settles_to is None:
            raise ValueError("tolerance belongs to equals and settles_to; remove it")
        if self.settles_to is not None and not self.tolerance:
            raise ValueError("settles_to needs a tolerance of more than 0: how near is settled")

    @property
    def is_of_signals(self) -> bool:
        """Whether it is judged sample by sample: a claim about a signal, or about rest."""
        return self.signal is not None or bool(self.at_rest)

    @property
    def subject(self) -> str:
        """The signal, difference or figure that the claim is about."""
        if self.of is not None:
            return f"{self.signal} - {self.of}"
        return self.signal or self.figure or "the robot"


def span_s(expect: ExpectTable, faults: Sequence[FaultTable]) -> tuple[float, float]:
    """Return from when to when an expectation is judged, with the faults of its scenario.

    Raises ValueError, with part of a message, for a fault that the scenario does not have.
    """
    return claimed_span_s(plain(expect), [plain(row) for row in faults])


def _limit(value: object) -> int | str:
    """Accept a whole number of ticks, or a share of them as text."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    if isinstance(value, str) and (share := _SHARE.fullmatch(value)) is not None and float(share[1]) <= 100.0:
        return value
    raise ValueError('expected a whole number of at least 0, or a share of the ticks such as "5%"')


Limit = Annotated[Any, _limit]
"""A whole number, or a share of the run's ticks as in ``"5%"``."""


@dataclass(frozen=True)
class AllowTable:
    """``[allow]``: how many events that no fault of the scenario explains a passing run may have.

    A key is one of the run's JSON; a share is one of the run's ticks. The defaults are those of lockstep.
    """

    stale_ticks: Annotated[Limit, "ticks not driven because the feedback or the truth was too old"] = 0
    held_ticks: Annotated[
        Limit, "ticks not driven because the state was unknown, the estimator lost, or the robot away"
    ] = 0
    rejected: Annotated[Limit, "frames that the host or the robot did not accept"] = 0
    refused: Annotated[Limit, "commands of the law that were not finite; the robot was held at rest instead"] = 0
    unmatched: Annotated[Limit, "torque feedforwards that the robot dropped, as their command was not there"] = 0
    fix_restarts: Annotated[Limit, "times that the fused estimate began again from pose fixes it had rejected"] = 0
    lost_rows: Annotated[Limit, "ticks that the recording lacks"] = 0


REALTIME_ALLOW: dict[str, int | str] = {"stale_ticks": "5%", "held_ticks": "5%"}
"""The defaults in real time, where they differ: a shared machine stalls now and then."""


def most(limit: int | str, ticks: int) -> int:
    """Return the greatest number that a limit allows in a run of ``ticks``."""
    return limit if isinstance(limit, int) else int(Fraction(limit.rstrip("% ")) * ticks / 100)
