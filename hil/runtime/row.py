"""The row of a tick: one number for each signal, for the recording and for the judge."""

from collections.abc import Sequence

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
)
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.signal_faults import SignalFaults
from hil.wire.statistics import LinkStatistics

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
_FEEDBACK = (
    Scaled("robot.time_s", 1e-9),
    "robot.state",
    None,
    "robot.command_age_ms",
    None,
    _wheels("speed_rad_s"),
    _wheels("current_a"),
    tuple(f"robot.acceleration_{axis}_m_s2" for axis in "xyz"),
    "robot.yaw_rate_rad_s",
)


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
        faults: SignalFaults | None = None,
    ) -> None:
        self._device = device
        self._wire = wire
        self._controller = controller
        self._extra = extra
        self._puts = tuple(sink.put for sink in sinks)
        self._feedback_latency_ns = feedback_latency_ns
        self._faults = faults
        self._rejected = 0
        speed_command = _wheels("speed_command_rad_s") if mode is CommandMode.SPEED else None
        # Kept by their owners between two ticks, and of no use to who only judges a run.
        standing = (
            _group("gain"),
            ("battery.voltage_v", "battery.current_a", _wheels("temperature_degc")),
            ("link.sent", "link.received", "link.lost", "link.rtt_ms"),
            ("link.sent_bytes", "link.received_bytes"),
            "link.load_percent",
            "link.rejected",
            "link.clock_offset_us",
            "link.clock_drift_ppm",
            tuple(own.signals for own in extra),
        )
        objects = (
            _group("loop"),
            (_REFERENCE[:3], _REFERENCE[3:6], _REFERENCE[6:]),
            (_group("pose"), _group("twist")),
            (None, _TRUTH, None),
            ((None, speed_command, _wheels("torque_command_n_m")), "guard.saturated", Scaled("link.latency_ms", 1e3)),
            _FEEDBACK,
            _group("estimator"),
            "guard.held",
            Scaled("link.feedback_age_ms", 1e-6),
            standing,
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
        """Return what the law, the device, the link and the extra parts have now."""
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
