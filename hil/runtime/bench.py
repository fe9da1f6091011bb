"""The bench of a run: robot, link, clock and truth, opened from a scenario and closed together."""

import contextlib
import random
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol, Self

from firmware_protocol.host import parameter_hash
from hil.core.clock import TICK_NS, LockstepClock, WallClock
from hil.core.errors import BadInputError, HilError, LinkError
from hil.core.extensions import Extensions
from hil.core.ports import Clock, FixSource, Link, PoseSource
from hil.core.signals import SIGNAL_NAMES
from hil.core.types import Pose
from hil.core.wheel_map import ImuMount
from hil.estimation.estimators import make_fixes
from hil.plant.child_output import ChildOutput
from hil.robot.direct import DirectLink
from hil.robot.handshake import Expected
from hil.robot.port import Device, Identity
from hil.robot.stm32 import Stm32
from hil.robot.virtual import MakeNode, MakeRobot, new_robot
from hil.runtime.fault_injection import RunFaults
from hil.runtime.local_robot import LocalRobot
from hil.runtime.robots import (
    firmware_values,
    link_of,
    needed_truth,
    no_lockstep,
    protocol_of,
    start_pose,
    wheel_map,
)
from hil.runtime.run_options import Instrument, Replayed
from hil.scenario import Scenario
from hil.scenario.commission import require_commissioned
from hil.scenario.plant import WiringTable
from hil.wire.conditions import ConditionedLink
from hil.wire.link_statistics import observe

if TYPE_CHECKING:
    from hil.record.journal import Journal
    from hil.wire.trace import Trace

NS = 1_000_000_000

_SESSIONS = Extensions("hil.sessions")


class RobotHere(Protocol):
    """A robot in this process. ``advance`` lets a number of ticks pass, for motor controllers in lockstep."""

    advance: Callable[[int], None] | None


class OpenSession(Protocol):
    """Opens the session with third-party motor controllers; registered as ``makers`` in the group ``hil.sessions``.

    ``local`` is the robot if it is in this process, or a recorded one. What watches over one elsewhere is ended by
    ``guarding``, which is closed after the link.
    """

    def __call__(
        self,
        scenario: Scenario,
        link: ConditionedLink,
        clock: Clock,
        local: "RobotHere | None",
        guarding: contextlib.ExitStack,
        *,
        allow_motion: bool,
    ) -> Device: ...


class Bench:
    """Link, robot, clock and truth of a run; a context manager that closes them all.

    If the link is within this process, the virtual robot is made here too. Otherwise the robot is elsewhere, and
    ``truth`` is the URL of its truth socket, if it has one. ``trace`` records the frames on the wire. ``make_robot``
    makes a robot in this process, ``make_node`` its firmware. ``instrument`` changes the link. ``signals`` names the
    run's signals. ``replayed`` takes the place of the robot. ``journal`` keeps what the session is told and sends.
    ``wiring_is_unknown`` is for what finds out how a robot is wired: anything else may not move one
    whose commissioning was begun and is not done.

    Raises BadInputError, LinkError or DeviceError when a part cannot be opened.

    Attributes:
        clock, device: the run's clock, and the host's session with the robot.
        wire: statistics of the link.
        faults: the faults of the run.
        truth, fixes: sources of true poses and of pose fixes, or None.
        local: the robot in this process, or None.
    """

    def __init__(
        self,
        scenario: Scenario,
        truth: str | None,
        *,
        allow_motion: bool,
        wiring_is_unknown: bool = False,
        trace: "Trace | None" = None,
        make_node: MakeNode | None = None,
        make_robot: MakeRobot = new_robot,
        instrument: Instrument | None = None,
        replayed: Replayed | None = None,
        journal: "Journal | None" = None,
        signals: Sequence[str] = SIGNAL_NAMES,
    ) -> None:
        self._scenario = scenario
        self._is_lockstep = scenario.loop.mode == "lockstep"
        self._has_hidden_wiring = scenario.plant.wiring != WiringTable()
        self._protocol = protocol_of(scenario.device)
        self.local: LocalRobot | None = None
        self._uncommissioned: str | None = None
        self.truth: PoseSource | None = None
        self.device: Device
        self._journal, self._replayed = journal, replayed
        self._keep = None if journal is None else journal.logs
        self._own_clock: Clock = LockstepClock() if self._is_lockstep else WallClock()
        self.clock = self._session_clock()
        rows = [table.row for table in scenario.fault]
        self.faults = RunFaults(rows, scenario.loop.seed, self._own_clock, signals, self._protocol)
        with contextlib.ExitStack() as resources:
            self.fixes = self._open_fixes()
            if self.fixes is not None:
                resources.callback(self.fixes.close)
            guarding = contextlib.ExitStack()
            if replayed is not None:
                self.truth, link = replayed.truth(), replayed.link(self.clock)
            elif link_of(scenario).is_within_process:
                self._check_no_truth(truth)
                self.local = local = LocalRobot(scenario, self.faults, make_node, make_robot, resources)
                self.truth, link = local.truth, local.link
            else:
                if allow_motion and not wiring_is_unknown:
                    self._uncommissioned = require_commissioned(scenario.commission)
                self._open_truth(truth, resources)
                resources.enter_context(guarding)  # released only after the link was closed
                link = link_of(scenario).open_host(self.faults.line, self._protocol)
                resources.callback(link.close)
            if journal is not None and self.truth is not None:
                from hil.record.journal import KeptTruth

                self.truth = KeptTruth(self.truth, journal, self._own_clock)
            conditioned = self._conditioned(link, trace, instrument)
            resources.callback(conditioned.close)
            if scenario.device.is_makers:
                subject = f"device.driver = {scenario.device.driver!r}"
                open_session: OpenSession = _SESSIONS.load("makers", subject)
                here = self.local or replayed
                self.device = open_session(scenario, conditioned, self.clock, here, guarding, allow_motion=allow_motion)
            else:
                self.device = self._stm32(conditioned, allow_motion=allow_motion)
            if isinstance(self.clock, LockstepClock):
                self.clock.step = self.device.step
            resources.callback(self.device.close)
            self._resources = resources.pop_all()

    def _session_clock(self) -> Clock:
        """Return the clock of session and loop: the journal keeps in real time when they read it."""
        if self._is_lockstep:
            return self._own_clock
        if self._replayed is not None:
            return self._replayed.clock
        if self._journal is None:
            return self._own_clock
        from hil.wire.kept import KeptClock

        return KeptClock(self._journal, self._own_clock)

    def _open_fixes(self) -> FixSource | None:
        scenario = self._scenario
        if self._replayed is not None:
            return self._replayed.fixes()
        fixes = make_fixes(scenario.estimator, scenario.loop.seed, scenario.link.feedback_latency_ns)
        if fixes is None or self._journal is None:
            return fixes
        from hil.record.journal import KeptFixes

        return KeptFixes(fixes, self._journal, self._own_clock)

    def _check_no_truth(self, truth: str | None) -> None:
        if truth is not None:
            raise BadInputError(
                f"--truth {truth}: the link {self._scenario.link.url} makes its robot in this process, which knows "
                "the truth; leave --truth out, or give the link of hil device"
            )

    def _open_truth(self, truth: str | None, resources: contextlib.ExitStack) -> None:
        scenario = self._scenario
        if self._is_lockstep and scenario.device.is_makers:
            raise no_lockstep(scenario.device.driver)
        client = None
        if truth is not None:
            from hil.robot.truth_client import TruthClient

            not_before = (lambda: self.device.tick * TICK_NS) if self._is_lockstep else None
            client = TruthClient(truth, scenario.hash, reset=True, not_before=not_before)
            resources.callback(client.close)
        elif (setting := needed_truth(scenario.estimator)) is not None:
            raise BadInputError(
                f"{setting}, but the robot is elsewhere and no truth was given; add --truth URL as hil device "
                "prints it, or --set estimator.source=odometry"
            )
        self.truth = client
        self.faults.arm(client)

    def _conditioned(self, link: Link, trace: "Trace | None", instrument: Instrument | None) -> ConditionedLink:
        """Wrap the link with its latencies, faults and statistics; the trace gets its frames from the statistics."""
        url, latency = link_of(self._scenario), self._scenario.link
        if trace is not None:
            trace.begin(time.time_ns() - self._own_clock.now_ns())
        self.wire = observe(link, url, self._own_clock, trace)
        if self._replayed is not None:  # what it tells has passed the conditions already
            return self._replayed.conditioned(link, self.clock, self._protocol)
        make = partial(
            ConditionedLink,
            link if instrument is None else instrument.link(link),
            self._own_clock,
            command_latency_ns=latency.command_latency_ns,
            feedback_latency_ns=latency.feedback_latency_ns,
            faults=self.faults.of_frames,
            scenario_time=self.faults.time,
            bus=self.faults.bus(url),
            observer=self.wire if self.wire.is_needed else None,
            protocol=self._protocol,
        )
        conditioned = make()
        # In lockstep our protocol's client keeps a log in C, at no cost, but without times of arrival.
        if self._journal is None or (conditioned.is_plain and isinstance(link, DirectLink)):
            return conditioned
        from hil.wire.kept import KeptLink

        self._keep = None
        return KeptLink(self._journal, self.clock, *make.args, **make.keywords)

    def _stm32(self, link: ConditionedLink, *, allow_motion: bool) -> Stm32:
        scenario = self._scenario
        expected = Expected(
            parameter_hash(firmware_values(scenario)),
            self._is_lockstep,
            allow_motion or self.local is not None or self._replayed is not None,
            scenario.robot.speed_limit_rad_s,
        )
        nonces = _nonces(scenario.loop.seed if self._is_lockstep else None)
        if self._replayed is not None:
            nonces = self._replayed.nonces
        wheels, imu = wheel_map(scenario.device), ImuMount(scenario.device.imu)
        return Stm32(link, scenario.controller.mode, expected, nonces, wheels, imu, self._keep)

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings for the user before anything moves: the device's, and ``uncommissioned``."""
        return [*self.device.warnings, *filter(None, (self.uncommissioned,))]

    @property
    def uncommissioned(self) -> str | None:
        """A warning for a real robot that nobody has commissioned; None without one."""
        return self._uncommissioned if self.truth is None else None

    def begin(self, origin_ns: int) -> None:
        """Set the start of the scenario's time: ``origin_ns`` on the clock, the first ACTIVE tick."""
        tick, feedback = self.device.tick, None
        with contextlib.suppress(LinkError):  # a lost link is found lost by the first tick, which handles that
            feedback = self.device.poll()
        if not self._is_lockstep:
            if self._scenario.device.is_makers:  # its feedback is stamped with this process's clock
                fix = self.truth.poll() if self.truth is not None else None
                tick = fix.time_ns // TICK_NS if fix is not None else tick
            elif feedback is not None:
                tick = feedback.robot_time_ns // TICK_NS
        self.faults.begin(origin_ns, tick)
        self.wire.begin()

    def connect(self) -> Identity:
        """Shake hands with the robot.

        Raises BadInputError for [plant.wiring] where the robot is real: its wiring is fixed.
        """
        identity = self.device.connect()
        if self.local is None and self.truth is None and identity.has_power_stage and self._has_hidden_wiring:
            raise BadInputError(
                "[plant.wiring] wires a virtual robot, and this one is real; remove the table, and say in [device] how "
                "the robot is wired"
            )
        return identity

    def start_pose(self) -> Pose:
        """Return the pose at which odometry starts; call it before the robot moves.

        If the scenario leaves it to a foreign FMU, this is the true pose, or the origin when no truth is available.
        """
        given = start_pose(self._scenario)
        fix = self.truth.poll() if given is None and self.truth is not None else None
        return given or (fix.pose if fix is not None else Pose(0.0, 0.0, 0.0))

    def robot_failure(self) -> HilError | None:
        """Return the error that ended the thread of the robot in this process, or None."""
        return self.local.failure if self.local is not None else None

    def stop_robot(self) -> HilError | None:
        """Stop the robot in this process at the end of the run. Return the error that ended it earlier, or None."""
        return self.local.stop() if self.local is not None else None

    @property
    def plant_output(self) -> ChildOutput | None:
        """Output and log lines of the plant's own process, or None."""
        return self.local.plant_output if self.local is not None else None

    @property
    def robot_threads(self) -> tuple[int, ...]:
        """Native ids of the threads that run the robot in this process."""
        return self.local.threads if self.local is not None else ()

    @property
    def slipped_ticks(self) -> int:
        """Robot time that the virtual robot in this process lost to stalls of this machine [ms]."""
        return self.local.slipped_ticks if self.local is not None else 0

    def close(self) -> None:
        """Close everything. Closing twice is allowed."""
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _nonces(seed: int | None) -> Iterator[int]:
    """Yield session nonces: in lockstep from the seed, so that runs repeat exactly, else from the system's source.

    The low 4 bits of each differ from those of the one before: the robot would refuse it as SESSION_USED (R-REF-4).
    """
    source = random.SystemRandom() if seed is None else random.Random(seed)
    session = None
    while True:
        nonce = source.randrange(1, 0x10000)
        if nonce & 0xF != session:
            session = nonce & 0xF
            yield nonce
