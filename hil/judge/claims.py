"""Claims of ``[[expect]]`` about signals, and their outcomes.

No side effects. A run adds sample by sample, and so reports a failure at once; a review checks a whole recording.
"""

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from hil.core.errors import UnknownSignalError, apart
from hil.core.model import RobotModel
from hil.core.signals import TRUE_POSE, WHEEL_SPEEDS, unit_of
from hil.judge.judged_run import ExpectationResult
from hil.judge.measure import Series
from hil.scenario.trial import ExpectTable, FaultTable, span_s

WITHOUT_VALUE = -1.0
"""The margin of a gap, and of no sample at all."""
_LARGEST = 1e6


def margin(expect: ExpectTable, lowest: float, highest: float) -> float:
    """Return how far values from ``lowest`` to ``highest`` are inside a claim; negative: how far outside.

    It is a share of the permitted interval, so that claims about different signals compare: 1 is half the interval's
    width. With a single limit 1 is the limit's size, or 1 if the limit is 0. It is continuous in the values, except
    for values that must be met exactly: 1 if they are. It is never 0.
    """
    above, below = expect.within or (expect.above, expect.below)
    centre = expect.equals if expect.settles_to is None else expect.settles_to
    is_open = expect.within is None and centre is None
    if centre is not None:
        scale = expect.tolerance or 0.0
        room = scale - max(abs(lowest - centre), abs(highest - centre))
    else:
        limits = [limit for limit in (above, below) if limit is not None]
        scale = (limits[-1] - limits[0]) / 2.0 if len(limits) == 2 else abs(limits[0]) or 1.0
        room = min(math.inf if below is None else below - highest, math.inf if above is None else lowest - above)
    if not scale:
        scale = abs(limits[0] if centre is None else centre) or 1.0
        room = room or scale
    holds = room > 0.0 or (room == 0.0 and not is_open)
    return math.copysign(min(max(abs(room) / scale, sys.float_info.min), _LARGEST), 1.0 if holds else -1.0)


class Claim(NamedTuple):
    """A claim about a value: ``holds`` is False for NaN; ``distance`` is how far a violating value is from it."""

    holds: Callable[[float], bool]
    distance: Callable[[float], float]
    text: str


def result_of(
    expect: ExpectTable,
    passed: bool | None,
    text: str,
    violation: tuple[float | None, float | None] = (None, None),
    **more: float | None,
) -> ExpectationResult:
    """Return the outcome of an expectation: its first violation as time and value, and further fields by name."""
    return ExpectationResult(expect.signal, expect.figure, expect.stops, passed, *violation, text=text, **more)


def signals_of(expect: ExpectTable) -> tuple[str, ...]:
    """Return the signals that a claim is judged by; none for a claim about a figure."""
    if expect.at_rest:
        return (*WHEEL_SPEEDS, *TRUE_POSE)
    return tuple(name for name in (expect.signal, expect.of) if name is not None)


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, math.tau) if math.isfinite(angle_rad) else math.nan


class _Rest:
    """The speed [rad/s] of the fastest wheel: as measured, or as the true movement between two ticks needs it.

    NaN where neither is known. Before there is a movement, None unless the wheels were measured.
    """

    def __init__(self, robot: RobotModel | None) -> None:
        self._robot = robot
        self._before: tuple[float, ...] | None = None

    def __call__(self, t_s: float, values: Sequence[float]) -> float | None:
        known = [abs(speed) for speed in values[:4] if not math.isnan(speed)]
        before, self._before = self._before, (t_s, *values[4:])
        if before is None:
            return max(known, default=None)
        dt_s, x_m, y_m, heading_rad = (new - old for new, old in zip(self._before, before, strict=True))
        if self._robot is not None and dt_s > 0.0 and math.isfinite(x_m + y_m + heading_rad):
            rim_m = math.hypot(x_m, y_m) + self._robot.lever_m * abs(_wrapped(heading_rad))
            known.append(rim_m / self._robot.wheel_radius_m / dt_s)
        return max(known, default=math.nan)


def _difference(expect: ExpectTable) -> Callable[[float, Sequence[float]], float | None]:
    """Return the value of a comparison: the difference, of two headings the shorter way around."""
    is_heading = unit_of(str(expect.signal)) == "rad"
    return lambda _t_s, values: _wrapped(values[0] - values[1]) if is_heading else values[0] - values[1]


_NUMBER = re.compile(r"(?<![\w.])([-+]?[\d.]+(?:e[-+]?\d+)?)(?: ± ([\d.]+(?:e[-+]?\d+)?))?")


def against(value: float, claim: str, digits: int) -> str:
    """Return a value in as many digits as tell it from the numbers in the text of a claim."""
    bounds = []
    for centre, tolerance in _NUMBER.findall(claim):
        bounds += [float(centre) - float(tolerance or 0.0), float(centre) + float(tolerance or 0.0)]
    return apart(value, *bounds, digits=digits)


def claim_of(expect: ExpectTable) -> Claim:
    if expect.within is not None:
        low, high = expect.within
        text = f"within {low:g} to {high:g}"
        return Claim(lambda value: low <= value <= high, lambda value: max(low - value, value - high), text)
    target = expect.equals if expect.settles_to is None else expect.settles_to
    if target is not None:
        centre, tolerance = target, expect.tolerance or 0.0
        word = "equals" if expect.settles_to is None else "settles to"
        text = f"{word} {centre:g}" + (f" ± {tolerance:g}" if tolerance else "")
        return Claim(lambda value: abs(value - centre) <= tolerance, lambda value: abs(value - centre), text)
    above, below = expect.above, expect.below
    if below is None:
        assert above is not None, "a scenario's expectation has one claim"
        return Claim(lambda value: value > above, lambda value: above - value, f"above {above:g}")
    if above is None:
        text = f"at rest, wheels below {below:g} rad/s," if expect.at_rest else f"below {below:g}"
        return Claim(lambda value: value < below, lambda value: value - below, text)
    return Claim(
        lambda value: above < value < below,
        lambda value: max(above - value, value - below),
        f"above {above:g} and below {below:g}",
    )


class Watch:
    """Checks one expectation about signals sample by sample.

    It fails when there are no samples in its time, or when one of them is NaN: neither shows that the claim holds.
    ``faults`` are those of the scenario. ``robot`` is its model; without it rest is judged by wheel speeds alone.

    Attributes:
        signals: those whose values ``add`` takes, in this order.
        from_s, to_s: its time, both included.
    """

    def __init__(self, expect: ExpectTable, faults: Sequence[FaultTable] = (), robot: RobotModel | None = None) -> None:
        self.expect = expect
        self.signals = signals_of(expect)
        self.from_s, self.to_s = span_s(expect, faults)
        self._value = _Rest(robot) if expect.at_rest else None if expect.of is None else _difference(expect)
        self._claim = claim_of(expect)
        self._settles = expect.settles_to is not None
        self._samples = 0
        self._held = 0  # number of newest samples in a row that hold
        self._held_since_s = 0.0
        self._first: tuple[float, float] | None = None  # violations, each with time and value
        self._worst = self._last = (math.nan, math.nan)
        self._worst_distance = -math.inf
        self._violations = 0
        self._since_s = 0.0  # start of the current violation
        self._violated_s = 0.0  # total of the violations that have ended
        self._lowest, self._highest = math.inf, -math.inf  # NaN is neither
        self._gaps = 0
        self._begin_s = 0.0
        self._newest = (math.nan, math.nan)

    def add(self, t_s: float, values: Sequence[float]) -> bool:
        """Add the signals at a time of the expectation; return whether the claim has just failed because of them."""
        value = values[0] if self._value is None else self._value(t_s, values)
        if value is None:
            return False
        self._samples += 1
        self._newest = (t_s, value)
        if self._samples == 1:
            self._begin_s = t_s
        if value < self._lowest:
            self._lowest = value
        if value > self._highest:
            self._highest = value
        if self._claim.holds(value):
            if not self._held:
                self._held_since_s = t_s
                if self._violations:
                    self._violated_s += t_s - self._since_s
            self._held += 1
            return False
        if self._held or not self._violations:
            self._since_s = t_s
        self._held = 0
        self._violations += 1
        self._last = (t_s, value)
        self._gaps += value != value
        distance = self._claim.distance(value)
        if self._first is None or distance > self._worst_distance:
            self._worst, self._worst_distance = self._last, -math.inf if math.isnan(distance) else distance
        is_first = self._first is None
        self._first = self._first or self._last
        return is_first and not self._settles

    def result(self, cut_s: float | None = None) -> ExpectationResult:
        """Return the outcome for the samples so far.

        ``cut_s`` is the time at which the run ended early; None for a complete run.
        """
        found = self._result(cut_s)
        return found if found.passed is None else found._replace(margin=self._margin())

    def _margin(self) -> float:
        """Return the margin of the samples so far.

        That of a ``settles_to`` is the last sample's, or, if less, the share of the time that was left when it settled.
        """
        if not self._samples:
            return WITHOUT_VALUE
        if self._settles:
            t_s, value = self._newest
            found = WITHOUT_VALUE if math.isnan(value) else margin(self.expect, value, value)
            if self._held == self._samples or not self._held:
                return found
            return min(found, (t_s - self._held_since_s) / (t_s - self._begin_s) or sys.float_info.min)
        if self._gaps == self._samples:
            return WITHOUT_VALUE
        found = margin(self.expect, self._lowest, self._highest)
        return min(found, WITHOUT_VALUE) if self._gaps else found

    def _result(self, cut_s: float | None) -> ExpectationResult:
        result = partial(result_of, self.expect)
        until = "to the end" if math.isinf(self.to_s) else f"to {self.to_s:g} s"
        which = self.expect.after_fault
        after = "" if which is None else f" ({self.expect.within_s:g} s after the fault {which})"
        claim = f"{self.expect.subject} {self._claim.text} from {self.from_s:g} s{after} {until}"
        if self._first is not None and not self._settles:
            violated_s = self._violated_s + (0.0 if self._held else self._last[0] - self._since_s)
            text = f"{claim}: failed, {_sample_text(self._first, self._claim.text)}"
            if self._violations > 1:
                text += f"; worst {_sample_text(self._worst, self._claim.text)}; {violated_s:.4g} s in all"
            worst_s, worst = self._worst
            return result(False, text, self._first, worst_s=worst_s, worst_value=worst, violated_s=violated_s)
        if cut_s is not None and self.to_s > cut_s:
            return result(None, f"{claim}: not judged, the run ended at t = {cut_s:.6g} s")
        if not self._samples:
            return result(False, f"{claim}: failed, the run has no samples there")
        if not self._held:
            text = f"{claim}: failed at the end, {_sample_text(self._last, self._claim.text)}"
            return result(False, text, self._last)
        if self._settles:
            text = f"{claim}: settled at t = {self._held_since_s:.6g} s, over {self._held} samples"
            return result(True, text, settled_s=self._held_since_s)
        return result(True, f"{claim}: held over {self._samples} samples")


def _sample_text(sample: tuple[float, float], claim: str) -> str:
    t_s, value = sample
    return f"{'no value' if math.isnan(value) else against(value, claim, 6)} at t = {t_s:.6g} s"


def check_expectation(
    expect: ExpectTable,
    signals: Mapping[str, Series],
    cut_s: float | None = None,
    faults: Sequence[FaultTable] = (),
    robot: RobotModel | None = None,
) -> ExpectationResult:
    """Check one expectation about signals against those of a run, ``loop.t_s`` among them.

    ``cut_s`` is the time at which the run ended early, or None; the rest is as for ``Watch``. Raises
    UnknownSignalError, which suggests similar names, for a signal that is not there.
    """
    watch = Watch(expect, faults, robot)
    for name in watch.signals:
        if name not in signals:
            raise UnknownSignalError(name, signals)
    t_s = signals["loop.t_s"]
    inside = (t_s >= watch.from_s) & (t_s <= watch.to_s)
    columns = (signals[name][inside].tolist() for name in watch.signals)
    for at_s, *values in zip(t_s[inside].tolist(), *columns, strict=True):
        watch.add(at_s, values)
    return watch.result(cut_s)
