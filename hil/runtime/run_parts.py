"""Makes the parts of a tick from a scenario. The robot and its link come from the bench (``bench.py``)."""

from collections.abc import Sequence

from hil.core.guard import Brake, Guard
from hil.core.motion_limits import MotionLimits
from hil.core.ports import Note, Sink
from hil.core.wheel_speed import WheelSpeed
from hil.estimation.estimators import make_estimator
from hil.judge.expectations import check_figures
from hil.references import Feasibility, feasibility, make_reference
from hil.runtime.bench import NS, Bench
from hil.runtime.sampling import Timing
from hil.runtime.tick import TickParts
from hil.scenario import Scenario
from hil.scenario.laws import make_laws


class RunParts:
    """The parts that need only the scenario. They are made before anything is opened, so that bad input is found first.

    Raises BadInputError when the law or the reference rejects its options, and for an expected figure that no run has.
    """

    def __init__(self, scenario: Scenario) -> None:
        check_figures(scenario)
        self._scenario = scenario
        self.model = scenario.robot
        self.reference = make_reference(scenario.reference.kind, scenario.reference.options, scenario.directory)
        self.laws = make_laws(scenario, scenario.directory)
        self.timing = Timing(
            scenario.loop.period_ns,
            scenario.link.command_latency_ns,
            scenario.link.feedback_latency_ns,
            round(scenario.firmware.watchdog_s * NS),
        )
        limiter, period_s = scenario.limiter, scenario.loop.period_ns / NS
        slip_m_s = limiter.most_slip_m_s(scenario.estimator.source)
        firmware = scenario.firmware
        speed = WheelSpeed(firmware.counts_per_revolution, firmware.tracking_bandwidth_rad_s)
        motion = MotionLimits(self.model, period_s, slip_m_s, limiter.torque_speed, speed)
        self._guard = Guard(self.model.speed_limit_rad_s, self.model.torque_limit_n_m, motion)
        self._brake = Brake(scenario.controller.mode, self._guard, firmware.speed_kp_n_m_s_rad)

    def feasibility(self) -> Feasibility:
        """Return the wheel speeds and torques that the reference demands."""
        loop = self._scenario.loop
        return feasibility(self.reference, self.model, loop.duration_s, loop.period_ns / NS)

    def make(self, bench: Bench, sinks: Sequence[Sink], note: Note) -> TickParts:
        """Return the parts of a tick, with all signals in its row.

        The bench's robot must be connected: it is asked for its start pose.
        """
        counts = self._scenario.firmware.counts_per_revolution
        return TickParts(
            bench.clock,
            bench.device,
            bench.wire,
            bench.truth,
            bench.fixes,
            make_estimator(self._scenario.estimator, self.model, bench.start_pose(), counts),
            self.reference,
            self.laws.controller,
            self._guard,
            self._brake,
            sinks,
            note,
            self.laws.signals,
            bench.robot_failure,
            bench.faults.signals,
            self.laws.extra,
        )
