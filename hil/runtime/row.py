"""The row of a tick: one number for each signal, for the recording and for the judge."""

import struct
from collections.abc import Sequence
from math import hypot, remainder, tau

from hil.core.ports import Controller, OwnSignals, Sink
from hil.core.signals import SIGNAL_NAMES, EstimatorSignals, LoopSignals
from hil.core.types import NAN, NAN_POSE, NAN_WHEELS, Applied, CommandMode, PoseFix, Reference, State, Twist
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.signal_faults import SignalFaults
from hil.wire.statistics import LinkStatistics

_NO_STATE = State(NAN_POSE, Twist(NAN, NAN, NAN))
_NO_FEEDBACK = (NAN, NAN, NAN, NAN, NAN_WHEELS, NAN_WHEELS, NAN_WHEELS, (NAN, NAN, NAN), NAN)
_REJECTED_EVERY = 100  # ticks; the sum over all causes is too slow for every tick


class RowWriter:
    """Puts a row per tick into sinks: the values of ``SIGNALS`` in order, then the signals of each of ``extra``."""

    def __init__(
        self,
        device: Device,
        wire: LinkStatistics,
        controller: Controller,
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
        width = len(SIGNAL_NAMES) + sum(len(own.signals) for own in extra)
        self._pack = struct.Struct(f"{width}d").pack

    def write(
        self,
        *,
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
        device, wire = self._device, self._wire
        if tick.tick % _REJECTED_EVERY == 0:
            self._rejected = sum(device.rejected().values())
        command, saturated, latency_s = applied
        pose, twist = state if state is not None else _NO_STATE
        truth = fix.pose if fix is not None else NAN_POSE
        (x_m, y_m, heading_rad), (desired_x_m, desired_y_m, desired_heading_rad) = truth, reference.pose
        error_x_m, error_y_m = x_m - desired_x_m, y_m - desired_y_m
        try:
            error_heading_rad = remainder(heading_rad - desired_heading_rad, tau)
        except ValueError:  # an infinite heading
            error_heading_rad = NAN
        robot_time_ns, robot_state, _, command_age_ms, _, speed, current, acceleration, yaw_rate_rad_s = (
            feedback if feedback is not None else _NO_FEEDBACK
        )
        battery_v, battery_a, temperature_degc = device.report.health
        sent, received, lost = device.counts()
        # The order of hil.core.signals.Sample; tests/test_row.py checks it. Named tuples per group were measured at 8
        # µs a row where this takes 1, in a tick of 30.
        values = [
            *tick,
            *reference.pose,
            *reference.twist,
            *reference.acceleration,
            *pose,
            *twist,
            *truth,
            error_x_m,
            error_y_m,
            error_heading_rad,
            hypot(error_x_m, error_y_m),
            *self._controller.gains,
            *speed,
            *(command.speed_rad_s if command.mode is CommandMode.SPEED else NAN_WHEELS),
            *command.torque_n_m,
            *current,
            *temperature_degc,
            robot_time_ns * 1e-9,
            robot_state,
            command_age_ms,
            yaw_rate_rad_s,
            *acceleration,
            battery_v,
            battery_a,
            *estimator,
            saturated,
            is_held,
            sent,
            received,
            self._rejected,
            (silent_ns + self._feedback_latency_ns) * 1e-6 if feedback is not None else NAN,
            lost,
            *wire.byte_counts(),
            wire.load_percent(),
            device.round_trip_ms,
            latency_s * 1e3,
            device.clock_sync.offset_us,
            device.clock_sync.drift_ppm,
        ]
        for own in self._extra:
            values += own.telemetry
        if self._faults is not None:
            values = self._faults.recorded(values)
        row = self._pack(*values)
        for put in self._puts:
            put(row)
