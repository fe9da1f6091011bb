"""The virtual robot that a run makes in this process: its link, thread, truth and faults."""

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING

from hil.core.errors import HilError
from hil.core.ports import Link, PoseSource
from hil.faults.rows import FaultRow
from hil.plant.child_output import ChildOutput
from hil.robot.direct import DirectTruth, open_direct
from hil.robot.virtual import MakeNode, MakeRobot
from hil.runtime.fault_injection import RunFaults
from hil.runtime.robots import link_of, node_maker, protocol_of, virtual_robot
from hil.scenario import Scenario

if TYPE_CHECKING:
    from hil.robot.virtual_server import VirtualServer

_ANSWER_S = 2.0


class LocalRobot:
    """Makes a scenario's robot, with its ``faults``, and opens both ends of its link; ``resources`` closes them.

    ``make_robot`` makes the robot, ``make_node`` its firmware. Raises BadInputError, LinkError or DeviceError.

    Attributes:
        robot: the robot itself.
        link: the host's end.
        truth: source of the robot's true pose.
        failure: the error that ended the robot's thread, or None.
        advance: lets a number of ticks pass, for motor controllers in lockstep; None for any other robot.
    """

    link: Link
    truth: PoseSource
    _server: "VirtualServer | None"

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
        self._server = None
        self._thread: threading.Thread | None = None
        self.failure: HilError | None = None
        self.advance: Callable[[int], None] | None = None
        faults.arm(self)  # before the link is opened: how it is opened depends on the rows
        url, is_makers, lockstep = link_of(scenario), scenario.device.is_makers, scenario.loop.mode == "lockstep"
        if lockstep and not is_makers and url.is_direct:
            self.truth = DirectTruth(robot)
            self.link = open_direct(robot, faults.line)
            resources.callback(self.link.close)
            return
        from hil.robot.virtual_server import LocalTruth, VirtualServer

        self.truth = truth = LocalTruth()
        self.link, wire = url.open_pair(faults.line, lockstep=lockstep, protocol=protocol_of(scenario.device))
        resources.callback(wire.close)
        resources.callback(self.link.close)
        self._server = VirtualServer(robot, wire, truth, lockstep=lockstep)
        if lockstep and is_makers:
            self.advance = self._server.advance
        else:
            self._thread = threading.Thread(target=self._serve, args=(self._server,), name="virtual-stm32", daemon=True)
            self._thread.start()
            resources.callback(self._end_thread)

    def _serve(self, server: "VirtualServer") -> None:
        try:
            server.serve()
        except HilError as error:
            self.failure = error

    def _end_thread(self) -> None:
        if self._server is not None and self._thread is not None:
            self._server.stop()
            self._thread.join()

    # Faults that act inside the robot

    def arm(self, rows: Sequence[FaultRow]) -> None:
        """Take the rows. Raises BadInputError when the robot cannot apply one of them."""
        self.robot.faults.arm(rows)

    def begin(self, tick: int) -> None:
        """Set the firmware tick at which the scenario's time began, between two exchanges, and wait until it is set."""
        self._between_exchanges(lambda: self.robot.faults.begin(tick))

    def applied(self) -> list[int]:
        """Return how often each row was applied so far."""
        return self.robot.faults.applied()

    def set_variables(self, values: Mapping[str, float]) -> None:
        """Set variables of the plant between two exchanges, and wait until they are set.

        Raises BadInputError and DeviceError as ``PlantPort.set_variable``.
        """

        def apply() -> None:
            for name, value in values.items():
                self.robot.plant.set_variable(name, value)

        self._between_exchanges(apply)

    def _between_exchanges(self, act: Callable[[], None]) -> None:
        """Act on the robot in its own thread, and wait until that is done. Raises the HilError that ``act`` raises."""
        if self._server is None or self._thread is None:
            act()
            return
        done: Future[None] = Future()

        def answer() -> None:
            try:
                act()
            except HilError as error:
                done.set_exception(error)
            else:
                done.set_result(None)

        self._server.run_between_exchanges(answer)
        with contextlib.suppress(TimeoutError):  # the run itself notices a robot that has failed
            done.result(_ANSWER_S)

    # State and end

    def stop(self) -> HilError | None:
        """Stop the robot at the end of the run. Return the error that ended it earlier, or None.

        Waits for a plant that hangs, until the plant's own time limit ends it.
        """
        self._end_thread()
        return self.failure or self.robot.failure()

    @property
    def plant_output(self) -> ChildOutput | None:
        return self.robot.output

    @property
    def threads(self) -> tuple[int, ...]:
        thread = self._thread
        return () if thread is None or not thread.is_alive() or thread.native_id is None else (thread.native_id,)

    @property
    def slipped_ticks(self) -> int:
        return self._server.slipped_ticks if self._server is not None else 0
