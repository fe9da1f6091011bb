"""The event log of a run, and what writes begin and end of faults and the outcome of expectations into it."""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from hil.core.ports import Event, Note
from hil.core.types import WHEEL_NAMES, Guarded, Limit
from hil.judge.claims import Watch
from hil.judge.judged_run import STATE_BEGINS, ExpectationResult
from hil.plant.child_output import ChildOutput, log_lines
from hil.scenario import Scenario

_value_at = struct.Struct("d").unpack_from  # at an offset in a row
_WHEELS = ("speed_command_rad_s", "torque_command_n_m", "speed_rad_s", "current_a")
_STATE_SIGNALS = (
    *("error.x_m", "error.y_m", "error.heading_rad", "error.planar_m", "guard.held"),
    *(f"wheel.{wheel}.{quantity}" for quantity in _WHEELS for wheel in WHEEL_NAMES),
)
QUIET_S = 1.0
_EVENTS_KEPT = 10_000
_LEVELS = {True: "info", None: "warning", False: "error"}


class EventLog:
    """The events of a run, the first 10,000 of them, each passed on to the next log, such as that of a recording."""

    def __init__(self, following: Note | None) -> None:
        self.events: list[Event] = []
        self._following = following

    def note(self, t_s: float, level: str, text: str) -> None:
        """Add an event; the level is debug, info, warning or error."""
        if len(self.events) < _EVENTS_KEPT:
            self.events.append(Event(t_s, "WARN" if level == "warning" else level.upper(), text))
        if self._following is not None:
            self._following(t_s, level, text)


class Takings:
    """Notes when the limiter of motion begins to take torque: again for the same limit after ``QUIET_S`` without it.

    ``why`` returns the reason of the newest taking.
    """

    def __init__(self, note: Note, why: Callable[[], str]) -> None:
        self._note, self._why = note, why
        self._last_s: dict[Limit, float] = {}

    def add(self, t_s: float, guarded: Guarded) -> None:
        """Take a tick in which torque was taken."""
        before_s = self._last_s.get(guarded.limit, -math.inf)
        self._last_s[guarded.limit] = t_s
        if t_s - before_s > QUIET_S:
            self._note(t_s, "warning", f"torque is taken from {self._why()}")


class RunEvents:
    """A sink that looks at each row and writes a line of the event log when something happens.

    A tick costs two comparisons, and one more per expectation about signals in its time. ``names`` are those of a row,
    ``needs`` and those of the scenario's expectations among them; ``newest`` returns the newest row, None before the
    first; ``output`` is the output of a plant that runs in its own process. If ``needs_rows`` is false, there is
    nothing to look for, and ``put`` need not be called.
    """

    needs = ("loop.t_s", *_STATE_SIGNALS)

    def __init__(
        self,
        scenario: Scenario,
        names: Sequence[str],
        note: Note,
        newest: Callable[[], bytes | None],
        output: ChildOutput | None = None,
    ) -> None:
        self._note = note
        self._output = output
        self._t_at = 8 * names.index("loop.t_s")
        self._expect = scenario.expect
        self._places = {name: 8 * place for place, name in enumerate(names)}
        self._newest = newest
        self._is_state_noted = False
        self._watches = {
            i: Watch(row, scenario.fault, scenario.robot) for i, row in enumerate(self._expect) if row.is_of_signals
        }
        self._open: dict[Watch, tuple[int, ...]] = {}
        self._undecided = dict.fromkeys(self._watches.values())
        self._noted: dict[int, str] = {}  # what was logged when an expectation failed
        self._in_force: list[str] = []
        edges: list[tuple[float, Callable[[], None]]] = []
        for fault in scenario.fault:
            edges.append((fault.start_s, partial(self._begin, fault.start_s, fault.words)))
            if not fault.is_instant:
                edges.append((fault.end_s, partial(self._end, fault.end_s, fault.words)))
        for watch in self._undecided:
            edges.append((watch.from_s, partial(self._watch, watch)))
            # A sample at exactly to_s is still checked.
            edges.append((math.nextafter(watch.to_s, math.inf), partial(self._decide, watch, watch.to_s, None)))
        self._edges = sorted(edges, key=lambda edge: edge[0], reverse=True)
        self._next_s = self._edges[-1][0] if edges else math.inf
        self.needs_rows = bool(edges) or output is not None

    def put(self, row: bytes) -> None:
        (t_s,) = _value_at(row, self._t_at)
        if t_s >= self._next_s:
            self._cross(t_s)
        if self._output is not None and self._output:
            log_lines(self._output.new_lines(), t_s, self._note)
        for watch, places in self._open.items():
            if watch.add(t_s, [_value_at(row, at)[0] for at in places]):
                self._note_failure(watch)

    def finish(self, t_s: float, *, is_cut: bool) -> dict[int, ExpectationResult]:
        """End the log after the last tick, at ``t_s``; return the outcomes of the expectations about signals.

        They are by their place in the scenario. ``is_cut``: the run ended before its planned duration.
        """
        if self._output is not None:
            log_lines(self._output.end(), t_s, self._note)
        for words in self._in_force:
            self._note(t_s, "info", f"fault ends with the run: {words}")
        if is_cut:
            self._note_state(t_s)
        cut_s = t_s if is_cut else None
        for watch in tuple(self._undecided):
            self._decide(watch, t_s, cut_s)
        return {i: watch.result(cut_s) for i, watch in self._watches.items()}

    def _cross(self, t_s: float) -> None:
        """Run the actions that are due at a tick. Those at infinity never are."""
        while self._edges and self._edges[-1][0] <= t_s:
            self._edges.pop()[1]()
        self._next_s = self._edges[-1][0] if self._edges else math.inf

    def _begin(self, at_s: float, words: str) -> None:
        self._in_force.append(words)
        self._note(at_s, "info", f"fault begins: {words}")

    def _end(self, at_s: float, words: str) -> None:
        self._in_force.remove(words)
        self._note(at_s, "info", f"fault ends: {words}")

    def _watch(self, watch: Watch) -> None:
        self._open[watch] = tuple(self._places[name] for name in watch.signals)

    def _note_failure(self, watch: Watch) -> None:
        """Log at once that an expectation has failed. The worst value is logged when its time window ends."""
        outcome = watch.result()
        assert outcome.violation_s is not None, "it was violated"
        self._noted[id(watch)] = outcome.text
        self._note(outcome.violation_s, "error", outcome.text)
        self._note_state(outcome.violation_s)

    def _note_state(self, t_s: float) -> None:
        row = self._newest()
        if row is None or self._is_state_noted:
            return
        self._is_state_noted = True
        self._note(t_s, "info", _state_text({name: _value_at(row, at)[0] for name, at in self._places.items()}))

    def _decide(self, watch: Watch, t_s: float, cut_s: float | None) -> None:
        self._open.pop(watch, None)
        del self._undecided[watch]
        outcome = watch.result(cut_s)
        noted = self._noted.get(id(watch))
        if outcome.text == noted:
            return
        at_s = t_s if outcome.violation_s is None or noted is not None else outcome.violation_s
        self._note(at_s, _LEVELS[outcome.passed], outcome.text)


def _state_text(row: Mapping[str, float]) -> str:
    def wheels(quantity: str, digits: int) -> str:
        values = [row[f"wheel.{wheel}.{quantity}"] for wheel in WHEEL_NAMES]
        return "" if all(map(math.isnan, values)) else ", ".join(_number(one, digits) for one in values)

    parts = []
    if not math.isnan(row["error.planar_m"]):
        x_mm, y_mm, heading_mrad = (_number(1e3 * row[f"error.{name}"], 1) for name in ("x_m", "y_m", "heading_rad"))
        parts.append(f"off by x {x_mm} mm, y {y_mm} mm, heading {heading_mrad} mrad")
    if row["guard.held"]:
        parts.append("held at rest, because its state was unknown or old")
    asked = [("speed_command_rad_s", 1, "rad/s"), ("torque_command_n_m", 2, "N·m")]
    words = [f"asked for {values} {unit}" for name, digits, unit in asked if (values := wheels(name, digits))][:1]
    words += [f"turned at {values} rad/s" for values in [wheels("speed_rad_s", 1)] if values]
    words += [f"drew {values} A" for values in [wheels("current_a", 2)] if values]
    parts += [f"wheels {', '.join(name.upper() for name in WHEEL_NAMES)} {'; '.join(words)}"] if words else []
    return STATE_BEGINS + "; ".join(parts)


def _number(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}"
