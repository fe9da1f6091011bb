"""The bench of a run: what stands at each end of the link, opened from a scenario and closed in one place."""

import contextlib
import random
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Self

from firmware_protocol.host import parameter_hash
from hil.core.clock import TICK_NS, LockstepClock, WallClock
from hil.core.errors import BadInputError, HilError
from hil.core.guard import Brake, Guard
from hil.core.ports import Clock, FixSource, Link, PoseSource
from hil.core.signals import SIGNAL_NAMES
from hil.core.types import Pose
from hil.drivers.host_watch import HostWatch, Unwatched, watch_over
from hil.drivers.makers import MakersRobot, Terms
from hil.drivers.motor_stop import StopTerms
from hil.drivers.port import Driver
from hil.drivers.registry import dialect
from hil.estimation.localisation import SimulatedFixes, UdpFixes
from hil.plant.child_output import ChildOutput
from hil.robot.direct import DirectTruth, open_direct
from hil.robot.faults import RobotFaults
from hil.robot.handshake import Expected
from hil.robot.port import Device, Identity
from hil.robot.stm32 import Stm32
from hil.robot.truth import TruthClient
from hil.robot.virtual import LocalTruth, MakeNode, MakeRobot, ServerThread, VirtualServer, VirtualStm32, new_robot
from hil.runtime.fault_injection import LocalFaults, RunFaults
from hil.runtime.robots import (
    firmware_values,
    link_of,
    needed_truth,
    no_lockstep,
    node_maker,
    protocol_of,
    start_pose,
    virtual_robot,
    wheel_map,
)
from hil.scenario import Scenario
from hil.scenario.motors import make_driver
from hil.wire.conditions import ConditionedLink
from hil.wire.statistics import observe
from hil.wire.trace import Trace

NS = 1_000_000_000
_ANSWER_S = 2.0


class Bench:
    """Link, robot, clock and truth of a run; a context manager that closes them all.

    With a link that stays within this process the virtual robot is made here too; else the robot is elsewhere, and
    ``truth`` is the URL of its truth socket, if it has one. ``trace`` is shown what is on the wire. ``make_robot``
    makes a robot that is made here, ``make_node`` its firmware; ``signals`` are those of the run.

    Raises BadInputError, LinkError or DeviceError when a part cannot be opened.
    """

    def __init__(
        self,
        scenario: Scenario,
        truth: str | None,
        *,
        allow_motion: bool,
        trace: Trace | None = None,
        make_node: MakeNode | None = None,
        make_robot: MakeRobot = new_robot,
        signals: Sequence[str] = SIGNAL_NAMES,
    ) -> None:
        self._scenario = scenario
        self._make_robot = make_robot
        self._make_node = make_node or node_maker(scenario)
        self.device: Device
        self._robot: VirtualStm32 | None = None
        self._server: VirtualServer | None = None
        self._thread: ServerThread | None = None
        self._watch: HostWatch = Unwatched()
        lockstep = scenario.loop.mode == "lockstep"
        url = link_of(scenario)
        protocol = protocol_of(scenario)
        self.clock: Clock = LockstepClock(lambda ticks: self.device.step(ticks)) if lockstep else WallClock()
        self.faults = RunFaults(
            [table.row for table in scenario.fault], scenario.loop.seed, self.clock, signals, protocol
        )
        with contextlib.ExitStack() as resources:
            self.truth: PoseSource | None = None
            self.fixes = self._fixes()
            if self.fixes is not None:
                resources.callback(self.fixes.close)
            if url.is_within_process:
                if truth is not None:
                    raise BadInputError(
                        f"--truth {truth}: the link {scenario.link.url} makes its robot in this process, which knows "
                        "the truth; leave --truth out, or give the link of hil device"
                    )
                link = self._open_within(resources)
            else:
                if lockstep and scenario.device.is_makers:
                    raise no_lockstep(scenario)
                if truth is None and (setting := needed_truth(scenario)) is not None:
                    raise BadInputError(
                        f"{setting}, but the robot is elsewhere and no truth was given; add --truth URL as hil device "
                        "prints it, or --set estimator.source=odometry"
                    )
                if truth is not None:
                    not_before = (lambda: self.device.tick * 1_000_000) if lockstep else None
                    self.truth = TruthClient(truth, scenario.hash, reset=True, not_before=not_before)
                    resources.callback(self.truth.close)
                self.faults.arm(self.truth)
                guarding = resources.enter_context(contextlib.ExitStack())  # which ends after the link was closed
                link = url.open_host(self.faults.line, protocol)
                resources.callback(link.close)
            if trace is not None:
                trace.begin(time.time_ns() - self.clock.now_ns())
            self.wire = observe(link, url, self.clock, trace)
            conditioned = ConditionedLink(
                link,
                self.clock,
                command_latency_ns=scenario.link.command_latency_ns,
                feedback_latency_ns=scenario.link.feedback_latency_ns,
                faults=self.faults.of_frames,
                scenario_time=self.faults.time,
                bus=self.faults.bus(url),
                observer=self.wire if self.wire.is_needed else None,
                protocol=protocol,
            )
            resources.callback(conditioned.close)
            driver = make_driver(scenario) if scenario.device.is_makers else None
            if driver is not None and self._robot is None:
                made, priority = dialect(scenario.device.driver), scenario.realtime.priority
                self._watch = watch_over(made, driver, url, scenario.device.guardian_s, priority)
                guarding.callback(self._watch.release)
            self.device = self._device(conditioned, driver, allow_motion=allow_motion or self._robot is not None)
            resources.callback(self.device.close)
            self._resources = resources.pop_all()

    def _device(self, link: ConditionedLink, driver: Driver | None, *, allow_motion: bool) -> Device:
        scenario = self._scenario
        lockstep = scenario.loop.mode == "lockstep"
        if driver is not None:
            firmware, mode = scenario.firmware, scenario.controller.mode
            torque_limit_n_m = min(firmware.torque_limit_n_m, scenario.robot.torque_limit_n_m)
            guard = Guard(scenario.robot.speed_limit_rad_s, torque_limit_n_m)
            brake = Brake(mode, guard, firmware.speed_kp_n_m_s_rad)
            stop = StopTerms(mode, firmware.ramp_s, firmware.watchdog_s, brake)
            advance = self._server.advance if lockstep and self._server is not None else None
            rearm = scenario.loop.rearm
            terms = Terms(stop, firmware.counts_per_revolution, allow_motion, rearm, advance, self._watch)
            return MakersRobot(link, self.clock, driver, wheel_map(scenario), terms)
        return Stm32(
            link,
            scenario.controller.mode,
            Expected(
                parameter_hash(firmware_values(scenario)), lockstep, allow_motion, scenario.robot.speed_limit_rad_s
            ),
            _nonces(scenario.loop.seed if lockstep else None),
            wheel_map(scenario),
        )

    def _open_within(self, resources: contextlib.ExitStack) -> Link:
        lockstep = self._scenario.loop.mode == "lockstep"
        self._robot = robot = resources.enter_context(self._make_robot(virtual_robot(self._scenario), self._make_node))
        self.faults.arm(LocalFaults(robot.faults, self._do))
        url, is_makers = link_of(self._scenario), self._scenario.device.is_makers
        if lockstep and not is_makers and url.is_direct:
            self.truth = DirectTruth(robot)
            link = open_direct(robot, self.faults.line)
            resources.callback(link.close)
            return link
        self.truth = truth = LocalTruth()
        pair = url.open_pair(self.faults.line, lockstep=lockstep, protocol=protocol_of(self._scenario))
        resources.callback(pair.wire.close)
        resources.callback(pair.link.close)
        self._server = server = VirtualServer(robot, pair.wire, truth, lockstep=lockstep)
        if not (lockstep and is_makers):  # those are served when time passes
            self._thread = ServerThread(server)
            resources.callback(self._thread.close)
        return pair.link

    def _do(self, work: Callable[[RobotFaults], None]) -> None:
        """Have the robot in this process do something between two exchanges, and wait for it."""
        assert self._robot is not None
        if self._server is None or self._thread is None:
            work(self._robot.faults)
            return
        done = threading.Event()
        self._server.ask(work)
        self._server.ask(lambda _: done.set())
        done.wait(_ANSWER_S)  # a robot that has failed is found out by the run itself

    def begin(self, origin_ns: int) -> None:
        """Let the scenario's time begin at this time of the clock, the first ACTIVE tick."""
        tick = self.device.tick
        feedback = self.device.poll()
        if self._scenario.loop.mode != "lockstep":
            if isinstance(self.device, MakersRobot):  # feedback has the time of this clock: those know none of ours
                fix = self.truth.poll() if self.truth is not None else None
                tick = fix.time_ns // TICK_NS if fix is not None else tick
            elif feedback is not None:
                tick = feedback.robot_time_ns // TICK_NS
        self.faults.begin(origin_ns, tick)
        self.wire.begin()

    def _fixes(self) -> FixSource | None:
        """Open where pose fixes come from, None where the estimator takes none."""
        estimator = self._scenario.estimator
        if estimator.source != "fused":
            return None
        if estimator.fix == "simulated":
            latency_ns = self._scenario.link.feedback_latency_ns
            return SimulatedFixes(estimator.simulated_fix, self._scenario.loop.seed, latency_ns)
        return UdpFixes(estimator.fix, estimator.filter.history_s)

    def connect(self) -> Identity:
        """Shake hands with the robot."""
        return self.device.connect()

    def start_pose(self) -> Pose:
        """Return where odometry begins, asked before the robot moves.

        Where the scenario leaves that to a foreign FMU it is the true pose, without truth the origin.
        """
        said = start_pose(self._scenario)
        fix = self.truth.poll() if said is None and self.truth is not None else None
        return said or (fix.pose if fix is not None else Pose(0.0, 0.0, 0.0))

    def robot_failure(self) -> HilError | None:
        """Return what ended the robot in this process while it ran beside the controller, or None."""
        return self._thread.failure if self._thread is not None else None

    def stop_robot(self) -> HilError | None:
        """Stop the robot in this process, when the run is over, and return what ended it before, if something did.

        A plant that hangs is waited for: its time limit ends it.
        """
        if self._thread is not None:
            self._thread.close()
            if (failure := self.robot_failure()) is not None:
                return failure
        return self._robot.failure() if self._robot is not None else None

    @property
    def plant_output(self) -> ChildOutput | None:
        """What the plant of the robot in this process prints and logs, where it has a process of its own."""
        return self._robot.output if self._robot is not None else None

    @property
    def robot_threads(self) -> tuple[int, ...]:
        """Native ids of the threads that are the robot in this process."""
        native_id = None if self._thread is None else self._thread.native_id
        return () if native_id is None else (native_id,)

    @property
    def slipped_ticks(self) -> int:
        """Robot time that the virtual robot in this process lost to stalls of this machine, in ms."""
        return self._server.slipped_ticks if self._server is not None else 0

    def close(self) -> None:
        """Close everything. Closing twice is allowed."""
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _nonces(seed: int | None) -> Iterator[int]:
    """Session nonces: from the seed in lockstep, which repeats exactly; else from the system's random source."""
    draw: Callable[[], int]
    if seed is None:
        draw = lambda: 1 + secrets.randbelow(0xFFFF)  # noqa: E731
    else:
        generator = random.Random(seed)
        draw = lambda: generator.randrange(1, 0x10000)  # noqa: E731
    while True:
        yield draw()
