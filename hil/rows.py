"""What a run tells of each tick: one row of all signals, for the recording and for the judge."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from hil.devices.snapshot import Feedback
from hil.devices.stm32 import Stm32
from hil.links.statistics import Statistics
from hil.ports import Controller, OwnSignals, Sink
from hil.signals import (
    BatterySignals,
    ErrorSignals,
    EstimatorSignals,
    GuardSignals,
    LinkSignals,
    LoopSignals,
    ReferenceSignals,
    RobotSignals,
    Sample,
)
from hil.types import NAN, NAN_POSE, NAN_WHEELS, Applied, CommandMode, Pose, PoseFix, Reference, State, Twist

_NAN_TWIST = Twist(NAN, NAN, NAN)
_REJECTED_EVERY = 100  # ticks; the sum over all causes is too dear for each of them


class Beliefs(NamedTuple):
    """What a tick rests on and what came of it; ``fix`` and ``state`` are None where nothing is known.

    ``is_held`` says that the law was not asked.
    """

    fix: PoseFix | None
    state: State | None
    reference: Reference
    applied: Applied
    estimator: EstimatorSignals
    is_held: bool


class Rows:
    """Puts one row a tick into a sink: ``SIGNALS``, then what each of ``extra`` has."""

    def __init__(
        self,
        device: Stm32,
        wire: Statistics,
        controller: Controller,
        extra: Sequence[OwnSignals],
        sink: Sink,
        feedback_latency_ns: int,
    ) -> None:
        self._device = device
        self._wire = wire
        self._controller = controller
        self._extra = extra
        self._sink = sink
        self._feedback_latency_ns = feedback_latency_ns
        self._rejected = 0

    def tell(self, tick: LoopSignals, feedback: Feedback | None, silent_ns: int, beliefs: Beliefs) -> None:
        """Tell of a tick; ``silent_ns`` is how long ``feedback`` has been the newest, which is None after a loss."""
        device, wire = self._device, self._wire
        if tick.tick % _REJECTED_EVERY == 0:
            self._rejected = sum(device.rejected().values())
        fix, state, reference, applied, estimator, is_held = beliefs
        command = applied.command
        age_ms = (silent_ns + self._feedback_latency_ns) * 1e-6 if feedback is not None else NAN
        truth = fix.pose if fix is not None else NAN_POSE
        row = Sample(
            tick,
            ReferenceSignals(*reference.pose, *reference.twist, *reference.acceleration),
            state.pose if state is not None else NAN_POSE,
            state.twist if state is not None else _NAN_TWIST,
            truth,
            _error(truth, reference.pose),
            self._controller.gains,
            feedback.speed_rad_s if feedback is not None else NAN_WHEELS,
            command.speed_rad_s if command.mode is CommandMode.SPEED else NAN_WHEELS,
            command.torque_n_m,
            feedback.current_a if feedback is not None else NAN_WHEELS,
            device.report.health.temperature_degc,
            _robot(feedback),
            BatterySignals(device.report.health.battery_v, device.report.health.battery_a),
            estimator,
            GuardSignals(applied.saturated, is_held),
            LinkSignals(
                device.sent,
                device.received,
                self._rejected,
                age_ms,
                device.snapshots_lost,
                wire.sent.bytes,
                wire.received.bytes,
                wire.load_percent(),
                device.round_trip.ms,
                applied.latency_s * 1e3,
                device.clock_sync.offset_us,
                device.clock_sync.drift_ppm,
            ),
        ).row()
        for own in self._extra:
            row += own.telemetry
        self._sink.put(row)


def _robot(feedback: Feedback | None) -> RobotSignals:
    if feedback is None:
        return RobotSignals(*[NAN] * len(RobotSignals._fields))
    return RobotSignals(
        feedback.robot_time_ns * 1e-9,
        feedback.state,
        feedback.command_age_ms,
        feedback.yaw_rate_rad_s,
        *feedback.acceleration_m_s2,
    )


def _error(truth: Pose, reference: Pose) -> ErrorSignals:
    x_m, y_m = truth.x_m - reference.x_m, truth.y_m - reference.y_m
    heading_rad = math.remainder(truth.heading_rad - reference.heading_rad, math.tau)
    return ErrorSignals(x_m, y_m, heading_rad, math.hypot(x_m, y_m))
