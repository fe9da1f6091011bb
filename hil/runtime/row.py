"""The row of a tick: one number for each signal, for the recording and for the judge."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from firmware_protocol.fast_calls import Objects, RowLayout, Scaled
from hil.core.ports import Controller, OwnSignals, Sink
from hil.core.signals import SIGNAL_NAMES, EstimatorSignals, LoopSignals
from hil.core.types import (
    NAN,
    NAN_POSE,
    NAN_WHEELS,
    WHEEL_NAMES,
    Applied,
    CommandMode,
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
_NO_FIX = (NAN, NAN_POSE, NAN)
_NO_FEEDBACK = (NAN, NAN, NAN, NAN, NAN, NAN_WHEELS, NAN_WHEELS, (NAN, NAN, NAN), NAN)
_REJECTED_EVERY = 100  # ticks; the sum over all causes is too slow for every tick


def _group(name: str) -> tuple[str, ...]:
    return tuple(signal for signal in SIGNAL_NAMES if signal.startswith(f"{name}."))


def _wheels(quantity: str) -> tuple[str, ...]:
    return tuple(f"wheel.{wheel}.{quantity}" for wheel in WHEEL_NAMES)


_REFERENCE, _TRUTH, _ERROR = _group("reference"), _group("truth"), _group("error")
DIFFERENCE_SIGNALS = (*_TRUTH, *_REFERENCE[:3], *_ERROR)
"""What every row has: the true pose, the reference's, and their difference."""


class _Row(NamedTuple):
    """The arguments of ``RowLayout.row``, in their order: of each the signals, or their columns."""

    tick: Any
    reference: Any
    state: Any
    truth: Any
    applied: Any
    feedback: Any
    estimator: Any
    is_held: Any
    feedback_age_ns: Any
    standing: Any


class _Standing(NamedTuple):
    """Gains, link statistics and the like, which parts of the run keep between ticks; only recorded rows have them."""

    gains: Any
    health: Any
    link: Any
    byte_counts: Any
    load_percent: Any
    rejected: Any
    clock_offset_us: Any
    clock_drift_ppm: Any
    extra: Any


def _columns(kind: type[NamedTuple], **columns: Objects | str | Scaled) -> Objects:
    """Return the columns of a tuple's members in the order of its fields, None for a member that is not named."""
    assert columns.keys() <= set(kind._fields), columns
    return tuple(columns.get(name) for name in kind._fields)


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
        standing = _columns(
            _Standing,
            gains=_group("gain"),
            health=("battery.voltage_v", "battery.current_a", _wheels("temperature_degc")),
            link=("link.sent", "link.received", "link.lost", "link.rtt_ms"),
            byte_counts=("link.sent_bytes", "link.received_bytes"),
            load_percent="link.load_percent",
            rejected="link.rejected",
            clock_offset_us="link.clock_offset_us",
            clock_drift_ppm="link.clock_drift_ppm",
            extra=tuple(own.signals for own in extra),
        )
        objects = _columns(
            _Row,
            tick=_group("loop"),
            reference=_columns(Reference, pose=_REFERENCE[:3], twist=_REFERENCE[3:6], acceleration=_REFERENCE[6:]),
            state=_columns(State, pose=_group("pose"), twist=_group("twist")),
            truth=_columns(PoseFix, pose=_TRUTH),
            applied=_columns(
                Applied,
                command=_columns(WheelCommand, **commands),
                saturated="guard.saturated",
                latency_s=Scaled("link.latency_ms", 1e3),
            ),
            feedback=_columns(
                Feedback,
                robot_time_ns=Scaled("robot.time_s", 1e-9),
                state="robot.state",
                command_age_ms="robot.command_age_ms",
                speed_rad_s=_wheels("speed_rad_s"),
                current_a=_wheels("current_a"),
                acceleration_m_s2=tuple(f"robot.acceleration_{axis}_m_s2" for axis in "xyz"),
                yaw_rate_rad_s="robot.yaw_rate_rad_s",
            ),
            estimator=_group("estimator"),
            is_held="guard.held",
            feedback_age_ns=Scaled("link.feedback_age_ms", 1e-6),
            standing=standing,
        )
        self._layout = RowLayout(names, objects, ("truth.x_m", "reference.x_m", "error.x_m"))
        self._row = self._layout.row
        self._has_standing = not _names_in(standing).isdisjoint(names)
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
        is_held: bool,
    ) -> None:
        """Write the row of a tick: its inputs and its results.

        ``silent_ns`` is the time since new feedback last came. ``feedback`` is None after a loss; ``fix`` and ``state``
        are None if unknown. ``is_held``: the law was not called.
        """
        if self._observes:  # a line with a bit rate is observed only here, for its load in the run
            self._wire.load_percent(self._wire.byte_counts())
        make_row = self._row
        row = make_row(
            tick,
            reference,
            _NO_STATE if state is None else state,
            _NO_FIX if fix is None else fix,
            applied,
            _NO_FEEDBACK if feedback is None else feedback,
            estimator,
            is_held,
            NAN if feedback is None else silent_ns + self._feedback_latency_ns,
            self._standing(tick.tick) if self._has_standing else None,
        )
        if self._faults is not None:
            row = self._faults.recorded(row)
        for put in self._puts:
            put(row)

    def _standing(self, tick: int) -> tuple[object, ...]:
        device, wire, extra = self._device, self._wire, self._extra
        byte_counts = wire.byte_counts()
        if tick % _REJECTED_EVERY == 0:
            self._rejected = sum(device.rejected().values())
        return (
            self._controller.gains,
            device.report.health,
            device.link_figures(),
            byte_counts,
            wire.load_percent(byte_counts) if wire.is_timed else NAN,
            self._rejected,
            device.clock_sync.offset_us,
            device.clock_sync.drift_ppm,
            tuple([own.telemetry for own in extra]) if extra else (),
        )


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
