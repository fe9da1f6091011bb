"""The virtual robot that a run makes in this process: its link, thread, truth and faults."""

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence

from hil.core.errors import HilError
from hil.core.ports import Link, PoseSource
from hil.faults.kind import FaultRow
from hil.plant.child_output import ChildOutput
from hil.robot.direct import DirectTruth, open_direct
from hil.robot.faults import RobotFaults
from hil.robot.virtual import MakeNode, MakeRobot
from hil.robot.virtual_server import LocalTruth, ServerThread, VirtualServer
from hil.runtime.fault_injection import RunFaults
from hil.runtime.robots import link_of, node_maker, protocol_of, virtual_robot
from hil.scenario import Scenario

_ANSWER_S = 2.0


class LocalRobot:
    """Makes a scenario's robot, with its ``faults``, and opens both ends of its link; ``resources`` closes them.

    ``make_robot`` makes the robot, ``make_node`` its firmware. Raises BadInputError, LinkError or DeviceError.

    Attributes:
        robot: the robot itself.
        link: the host's end.
        truth: source of the robot's true pose.
        advance: lets a number of ticks pass, for motor controllers in lockstep; None for any other robot.
    """

    link: Link
    truth: PoseSource

    def __init__(
        self,
        scenario: Scenario,
        faults: RunFaults,
        make_node: MakeNode | None,
        make_robot: MakeRobot,
        resources: contextlib.ExitStack,
    ) -> None:
        made = make_robot(virtual_robot(scenario), make_node or node_maker(scenario.device))
        self.robot = robot = resources.enter_context(made)
        self._server: VirtualServer | None = None
        self._thread: ServerThread | None = None
        self.advance: Callable[[int], None] | None = None
        faults.arm(self)  # before the link is opened: how it is opened depends on the rows
        url, is_makers, lockstep = link_of(scenario), scenario.device.is_makers, scenario.loop.mode == "lockstep"
        if lockstep and not is_makers and url.is_direct:
            self.truth = DirectTruth(robot)
            self.link = open_direct(robot, faults.line)
            resources.callback(self.link.close)
            return
        self.truth = truth = LocalTruth()
        self.link, wire = url.open_pair(faults.line, lockstep=lockstep, protocol=protocol_of(scenario.device))
        resources.callback(wire.close)
        resources.callback(self.link.close)
        self._server = VirtualServer(robot, wire, truth, lockstep=lockstep)
        if lockstep and is_makers:
            self.advance = self._server.advance
        else:
            self._thread = ServerThread(self._server)
            resources.callback(self._thread.close)

    # Faults that act inside the robot

    def arm(self, rows: Sequence[FaultRow]) -> None:
        """Take the rows. Raises BadInputError when the robot cannot apply one of them."""
        self.robot.faults.arm(rows)

    def begin(self, tick: int) -> None:
        """Set the firmware tick at which the scenario's time began, between two exchanges, and wait until it is set."""

        def begin(faults: RobotFaults) -> None:
            faults.begin(tick)

        if self._server is None or self._thread is None:
            begin(self.robot.faults)
            return
        done = threading.Event()
        self._server.run_on_faults(begin)
        self._server.run_on_faults(lambda _: done.set())
        done.wait(_ANSWER_S)  # the run itself notices a robot that has failed

    def applied(self) -> list[int]:
        """Return how often each row was applied so far."""
        return self.robot.faults.applied()

    def set_variables(self, values: Mapping[str, float]) -> None:
        """Set variables of the plant between two exchanges, and wait until they are set.

        Raises BadInputError and DeviceError as ``PlantPort.set_variable``.
        """
        if self._server is None or self._thread is None:
            for name, value in values.items():
                self.robot.plant.set_variable(name, value)
            return
        done, problems = threading.Event(), list[HilError]()

        def apply() -> None:
            try:
                for name, value in values.items():
                    self.robot.plant.set_variable(name, value)
            except HilError as error:
                problems.append(error)
            done.set()

        self._server.run_on_faults(lambda _: apply())
        done.wait(_ANSWER_S)
        if problems:
            raise problems[0]

    # State and end

    def thread_failure(self) -> HilError | None:
        """Return the error that ended the robot's thread, or None."""
        return self._thread.failure if self._thread is not None else None

    def stop(self) -> HilError | None:
        """Stop the robot at the end of the run. Return the error that ended it earlier, or None.

        Waits for a plant that hangs, until the plant's own time limit ends it.
        """
        if self._thread is not None:
            self._thread.close()
        return self.thread_failure() or self.robot.failure()

    @property
    def plant_output(self) -> ChildOutput | None:
        """Output and log lines of the plant's own process, or None."""
        return self.robot.output

    @property
    def threads(self) -> tuple[int, ...]:
        """Native ids of the threads that run the robot."""
        native_id = None if self._thread is None else self._thread.native_id
        return () if native_id is None else (native_id,)

    @property
    def slipped_ticks(self) -> int:
        """Robot time that the robot lost to stalls of this machine [ms]."""
        return self._server.slipped_ticks if self._server is not None else 0
