"""The bench of a run: what stands at each end of the link, opened from a scenario and closed in one place."""

import contextlib
import random
import secrets
from collections.abc import Callable, Iterator, Mapping
from types import TracebackType
from typing import Self

from firmware_protocol.host import parameter_hash, parameters
from hil.clock import LockstepClock, WallClock
from hil.devices.handshake import Expected, RobotInfo
from hil.devices.stm32 import Stm32
from hil.devices.truth import TruthClient
from hil.devices.virtual import LocalTruth, ServerThread, VirtualRobot, VirtualServer, VirtualStm32
from hil.devices.wheel_map import WheelMap
from hil.errors import BadInputError, HilError
from hil.links.delay import DelayedLink
from hil.links.faults import Fault, FaultLink
from hil.links.opening import is_within_process, open_host, open_pair
from hil.links.url import parse_link
from hil.plant import archive
from hil.ports import Clock, Link, PoseSource
from hil.scenario import FaultTable, Scenario
from hil.types import Pose

NS = 1_000_000_000


def firmware_values(scenario: Scenario) -> dict[str, float]:
    """Return the firmware's parameters by the names of its own table.

    Raises BadInputError when the host library is not built.
    """
    given = dict(scenario.firmware) | {"feedback_period_s": scenario.loop.period_ns / NS}
    try:
        return {p.name: float(given[p.name]) for p in parameters()}
    except FileNotFoundError as error:
        raise BadInputError(str(error)) from error


def plant_start(scenario: Scenario) -> dict[str, float]:
    """Return the FMU's parameters: what [robot] and [firmware] say, and over them what [plant.start] says."""
    robot, firmware = scenario.robot, scenario.firmware
    believed = {
        "mass_kg": robot.mass_kg,
        "inertia_kg_m2": robot.inertia_kg_m2,
        "wheel_radius_m": robot.wheel_radius_m,
        "half_length_m": robot.half_length_m,
        "half_width_m": robot.half_width_m,
        "wheel_inertia_kg_m2": robot.wheel_inertia_kg_m2,
        "friction_coefficient": robot.friction_coefficient,
        "counts_per_revolution": float(firmware.counts_per_revolution),
        "motor_constant_n_m_a": firmware.torque_constant_n_m_a,
    }
    return believed | dict(scenario.plant.start)


def start_pose(scenario: Scenario) -> Pose:
    """Return where the scenario says that the robot starts; odometry begins there."""
    start = scenario.plant.start
    return Pose(*(start.get(f"start_{name}", 0.0) for name in ("x_m", "y_m", "heading_rad")))


def virtual_robot(scenario: Scenario) -> VirtualRobot:
    """Return what the scenario's virtual robot is made of. Raises BadInputError when its FMU is missing."""
    return VirtualRobot(
        archive.locate(scenario.plant.fmu, scenario.directory),
        plant_start(scenario),
        firmware_values(scenario),
        scenario.loop.mode == "lockstep",
        wheel_map(scenario),
    )


def wheel_map(scenario: Scenario) -> WheelMap:
    """Return how the scenario's robot is wired."""
    return WheelMap(scenario.device.wheels, scenario.device.reversed)


class Bench:
    """Link, robot, clock and truth of a run; a context manager that closes them all.

    With a link that stays within this process the virtual robot is made here too; else the robot is elsewhere, and
    ``truth`` is the URL of its truth socket, if it has one.

    Raises BadInputError, LinkError or DeviceError when a part cannot be opened.
    """

    def __init__(self, scenario: Scenario, truth: str | None, *, allow_motion: bool) -> None:
        self._scenario = scenario
        self.device: Stm32
        self._robot: VirtualStm32 | None = None
        self._server: VirtualServer | None = None
        self._thread: ServerThread | None = None
        lockstep = scenario.loop.mode == "lockstep"
        url = parse_link(scenario.link.url)
        with contextlib.ExitStack() as resources:
            self.truth: PoseSource | None = None
            if is_within_process(url):
                if truth is not None:
                    raise BadInputError(
                        f"--truth {truth}: the link {scenario.link.url} makes its robot in this process, which knows "
                        "the truth; leave --truth out, or give the link of hil device"
                    )
                link = self._open_within(resources)
            else:
                self._check_truth_source(truth)
                if truth is not None:
                    not_before = (lambda: self.device.tick * 1_000_000) if lockstep else None
                    self.truth = TruthClient(truth, scenario.hash, reset=True, not_before=not_before)
                    resources.callback(self.truth.close)
                link = open_host(url)
                resources.callback(link.close)
            self.clock: Clock = LockstepClock(lambda ticks: self.device.step(ticks)) if lockstep else WallClock()
            self.faults = FaultLink(link, self.clock, _faults(scenario.fault), scenario.loop.seed)
            latencies = (scenario.link.command_latency_ns, scenario.link.feedback_latency_ns)
            delayed = DelayedLink(self.faults, self.clock, *latencies)
            self.device = Stm32(
                delayed,
                scenario.controller.mode,
                Expected(parameter_hash(firmware_values(scenario)), lockstep, allow_motion),
                _nonces(scenario.loop.seed if lockstep else None),
                wheel_map(scenario),
            )
            self._resources = resources.pop_all()

    def _open_within(self, resources: contextlib.ExitStack) -> Link:
        lockstep = self._scenario.loop.mode == "lockstep"
        self._robot = robot = VirtualStm32(virtual_robot(self._scenario))
        resources.callback(robot.close)
        pair = open_pair(parse_link(self._scenario.link.url))
        resources.callback(pair.wire.close)
        resources.callback(pair.link.close)
        self.truth = truth = LocalTruth()
        self._server = server = VirtualServer(robot, pair.wire, truth, lockstep=lockstep)
        if lockstep and pair.memory is not None:
            # No thread is needed: the robot is served when the host waits for it.
            pair.memory.on_starved = lambda: server.service(0)
        else:
            self._thread = ServerThread(server)
            resources.callback(self._thread.close)
        return pair.link

    def _check_truth_source(self, truth: str | None) -> None:
        if truth is None and self._scenario.estimator.source == "truth":
            raise BadInputError(
                'estimator.source = "truth", but the robot is elsewhere and no truth was given; add --truth URL as '
                "hil device prints it, or --set estimator.source=odometry"
            )

    def connect(self) -> RobotInfo:
        """Shake hands with the robot."""
        return self.device.connect()

    @property
    def robot_failure(self) -> HilError | None:
        """What ended the robot in this process, if something did."""
        if self._thread is not None and self._thread.failure is not None:
            return self._thread.failure
        return self._robot.failure() if self._robot is not None else None

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


def _faults(rows: tuple[FaultTable, ...]) -> list[Fault]:
    directions: Mapping[str, str | None] = {"command": "command", "feedback": "feedback"}
    faults = []
    for row in rows:
        direction = directions.get(row.target)
        message = None if direction else row.target
        end_ns = 2**63 if row.end_s == float("inf") else round(row.end_s * NS)
        faults.append(Fault(row.kind, direction, message, round(row.start_s * NS), end_ns, row.value))
    return faults


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
