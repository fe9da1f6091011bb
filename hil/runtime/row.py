"""The row of a tick: one number for each signal, for the recording and for the judge."""

from array import array
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from firmware_protocol.extension import wheel
from hil.core.ports import Controller, OwnSignals, Sink
from hil.core.signals import SIGNAL_NAMES, EstimatorSignals, LoopSignals
from hil.core.types import (
    NAN,
    NAN_POSE,
    NAN_WHEELS,
    WHEEL_NAMES,
    Applied,
    CommandMode,
    Guarded,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
)
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.wire.link_statistics import LinkStatistics

if TYPE_CHECKING:
    from hil.runtime.signal_faults import SignalFaults

_NO_STATE = State(NAN_POSE, Twist(NAN, NAN, NAN))
_NO_FIX: Any = (NAN, NAN_POSE, NAN)
_NO_FEEDBACK: Any = (NAN, NAN, NAN, NAN, NAN, NAN_WHEELS, NAN_WHEELS, (NAN, NAN, NAN), NAN)
_REJECTED_EVERY = 100  # ticks; the sum over all causes is too slow for every tick


def _group(name: str) -> tuple[str, ...]:
    return tuple(signal for signal in SIGNAL_NAMES if signal.startswith(f"{name}."))


def _wheels(quantity: str) -> tuple[str, ...]:
    return tuple(f"wheel.{wheel}.{quantity}" for wheel in WHEEL_NAMES)


_REFERENCE, _TRUTH, _ERROR = _group("reference"), _group("truth"), _group("error")
DIFFERENCE_SIGNALS = (*_TRUTH, *_REFERENCE[:3], *_ERROR)
"""What every row has: the true pose, the reference's, and their difference."""


class Scaled(NamedTuple):
    """A signal that is a number times ``unit``."""

    name: str
    unit: float


Objects = tuple["str | Scaled | Objects | None", ...]
"""Which signal each member of a tuple is: a name, another tuple, or None for what is left out."""


def _columns(kind: type[NamedTuple], **columns: Objects | str | Scaled) -> Objects:
    """Return the columns of a tuple's members in the order of its fields, None for a member that is not named."""
    assert columns.keys() <= set(kind._fields), columns
    return tuple(columns.get(name) for name in kind._fields)


def row_of(names: Sequence[str], objects: "Mapping[str, str | Scaled | Objects]", first: Sequence[str]) -> wheel.Row:
    """Return what makes rows of the signals ``names``, in their order, of named objects (``wheel.Row.make``).

    ``objects`` says which signal each number of an object is. A name that is not among ``names`` is left out, and so is
    a tuple of such names, which may be None then. ``first`` names three signals, each the first of a group: two poses
    (x, y, heading), and their difference (x, y, heading in [-π, π], distance). Raises BuildError without the extension
    module.
    """
    places, units = {name: place for place, name in enumerate(names)}, array("d", [1.0]) * len(names)

    def place_of(one: str | Scaled | Objects | None) -> Any:
        if isinstance(one, Scaled):
            if one.name in places:
                units[places[one.name]] = one.unit
            return places.get(one.name, -1)
        if one is None or isinstance(one, str):
            return places.get(one or "", -1)
        inner = tuple(map(place_of, one))
        return -1 if set(inner) <= {-1} else inner

    found = tuple(map(place_of, objects.values()))
    pose, other, difference = (places[name] for name in first)
    return wheel.Row(tuple(objects), found, units.tobytes(), (pose, other, difference))


class RowWriter:
    """Puts a row per tick into sinks: the values of the signals ``names``, in their order.

    They are of ``SIGNALS`` and of each of ``extra``, those of ``DIFFERENCE_SIGNALS`` among them. What belongs to others
    is not asked for.
    """

    def __init__(
        self,
        names: Sequence[str],
        device: Device,
        wire: LinkStatistics,
        controller: Controller,
        mode: CommandMode,
        extra: Sequence[OwnSignals],
        sinks: Sequence[Sink],
        feedback_latency_ns: int,
        faults: "SignalFaults | None" = None,
    ) -> None:
        self._device = device
        self._wire = wire
        self._controller = controller
        self._extra = extra
        self._puts = tuple(sink.put for sink in sinks)
        self._feedback_latency_ns = feedback_latency_ns
        self._faults = faults
        self._rejected = 0
        commands = {"torque_n_m": _wheels("torque_command_n_m")}
        if mode is CommandMode.SPEED:
            commands["speed_rad_s"] = _wheels("speed_command_rad_s")
        standing: dict[str, str | Scaled | Objects] = {
            "gains": _group("gain"),
            "health": ("battery.voltage_v", "battery.current_a", _wheels("temperature_degc")),
            "link": ("link.sent", "link.received", "link.lost", "link.rtt_ms"),
            "byte_counts": ("link.sent_bytes", "link.received_bytes"),
            "load_percent": "link.load_percent",
            "rejected": "link.rejected",
            "clock_offset_us": "link.clock_offset_us",
            "clock_drift_ppm": "link.clock_drift_ppm",
            "extra": tuple(own.signals for own in extra),
        }
        objects: dict[str, str | Scaled | Objects] = {
            "tick": _group("loop"),
            "reference": _columns(Reference, pose=_REFERENCE[:3], twist=_REFERENCE[3:6], acceleration=_REFERENCE[6:]),
            "state": _columns(State, pose=_group("pose"), twist=_group("twist")),
            "truth": _columns(PoseFix, pose=_TRUTH),
            "applied": _columns(
                Applied,
                command=_columns(WheelCommand, **commands),
                saturated="guard.saturated",
                latency_s=Scaled("link.latency_ms", 1e3),
            ),
            "feedback": _columns(
                Feedback,
                robot_time_ns=Scaled("robot.time_s", 1e-9),
                state="robot.state",
                command_age_ms="robot.command_age_ms",
                speed_rad_s=_wheels("speed_rad_s"),
                current_a=_wheels("current_a"),
                acceleration_m_s2=tuple(f"robot.acceleration_{axis}_m_s2" for axis in "xyz"),
                yaw_rate_rad_s="robot.yaw_rate_rad_s",
            ),
            "estimator": _group("estimator"),
            "guarded": _columns(Guarded, held="guard.held", limit="guard.limit", taken_n_m="guard.taken_n_m"),
            "feedback_age_ns": Scaled("link.feedback_age_ms", 1e-6),
        }
        self._row = row_of(names, objects | standing, ("truth.x_m", "reference.x_m", "error.x_m"))
        self._has_standing = not _names_in(tuple(standing.values())).isdisjoint(names)
        self._observes = wire.is_timed and not self._has_standing

    def write(
        self,
        tick: LoopSignals,
        feedback: Feedback | None,
        silent_ns: int,
        fix: PoseFix | None,
        state: State | None,
        reference: Reference,
        applied: Applied,
        estimator: EstimatorSignals,
        guarded: Guarded,
    ) -> None:
        """Write the row of a tick: its inputs and its results.

        ``silent_ns`` is the time since new feedback last came. ``feedback`` is None after a loss; ``fix`` and ``state``
        are None if unknown.
        """
        if self._observes:  # a line with a bit rate is observed only here, for its load in the run
            self._wire.load_percent(self._wire.byte_counts())
        state = _NO_STATE if state is None else state
        fix = _NO_FIX if fix is None else fix
        age_ns = NAN if feedback is None else silent_ns + self._feedback_latency_ns
        feedback = _NO_FEEDBACK if feedback is None else feedback
        if not self._has_standing:
            row = self._row.make(
                tick=tick, reference=reference, state=state, truth=fix, applied=applied, feedback=feedback,
                estimator=estimator, guarded=guarded, feedback_age_ns=age_ns,
            )  # fmt: skip
        else:
            device, wire, extra = self._device, self._wire, self._extra
            byte_counts = wire.byte_counts()
            if tick.tick % _REJECTED_EVERY == 0:
                self._rejected = sum(device.rejected().values())
            row = self._row.make(
                tick=tick, reference=reference, state=state, truth=fix, applied=applied, feedback=feedback,
                estimator=estimator, guarded=guarded, feedback_age_ns=age_ns,
                gains=self._controller.gains, health=device.report.health, link=device.link_figures(),
                byte_counts=byte_counts, load_percent=wire.load_percent(byte_counts) if wire.is_timed else NAN,
                rejected=self._rejected, clock_offset_us=device.clock_sync.offset_us,
                clock_drift_ppm=device.clock_sync.drift_ppm,
                extra=tuple([own.telemetry for own in extra]) if extra else (),
            )  # fmt: skip
        if self._faults is not None:
            row = self._faults.recorded(row)
        for put in self._puts:
            put(row)


def _names_in(objects: Objects) -> set[str]:
    found: set[str] = set()
    for member in objects:
        if isinstance(member, str):
            found.add(member)
        elif isinstance(member, Scaled):
            found.add(member.name)
        elif member is not None:
            found |= _names_in(member)
    return found
