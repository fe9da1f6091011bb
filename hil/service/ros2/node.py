"""The managed node ``mecanum_hil``: a robot of ours as ROS 2 sees it (ROS2.md). Import it after ``require_ros``."""

import logging
import signal
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from hil.core.types import Pose
from hil.scenario import Scenario
from hil.service import logs
from hil.service.messages import Action
from hil.service.ros2.commands import Commands
from hil.service.ros2.publishers import Publishers
from hil.service.ros2.robot import OwnService, Robot, ServedRobot
from hil.service.ros2.settings import Settings
from hil.service.ros2.simulation import Pace, Simulation, start_at
from hil.service.ros2.simulator import ClockPublisher, Simulator

NAME = "mecanum_hil"
_ORDERS = (Action.ARM, Action.DISARM, Action.ESTOP, Action.CLEAR, Action.STOP)
_LOOK_S = 0.2


class RobotNode(LifecycleNode):  # type: ignore[misc]
    """The node. Attributes: ``settings``, its parameters; ``is_active``, its state in the sense of a managed node."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(NAME)
        self._scenario = scenario
        self.settings = Settings.declared(self)
        self.is_active = False
        self._robot: Robot | None = None
        self._out: Publishers | None = None
        self._in: Commands | None = None
        for action in _ORDERS:  # in every state of the node: an e-stop must not depend on it
            self.create_service(Trigger, f"~/{action.value}", partial(self._serve, action))

    def use(self, robot: Robot) -> None:
        """Be the node of a robot, and with ``autostart`` become active."""
        self._robot = robot
        if self.settings.autostart:
            self.trigger_configure()
            self.trigger_activate()
        robot.start(self._hear)

    # States of a managed node

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        """Make topics."""
        assert self._robot is not None
        self._out = Publishers(self, self.settings)
        self._in = Commands(self, self.settings, self._scenario, self._robot)
        return super().on_configure(state)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Publish, and pass commands on. It arms nothing."""
        result = super().on_activate(state)
        self.is_active = True
        return result

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Stop the robot; publish and pass on nothing."""
        self.is_active = False
        if self._robot is not None:
            self._robot.order(Action.STOP, {}, lambda _: None)
        return super().on_deactivate(state)

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        """Give the topics up."""
        self._end_topics()
        return super().on_cleanup(state)

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        """Stop the robot and give the topics up."""
        self.is_active = False
        if self._robot is not None:
            self._robot.order(Action.STOP, {}, lambda _: None)
        self._end_topics()
        return super().on_shutdown(state)

    def _end_topics(self) -> None:
        if self._in is not None:
            self._in.close()
        self._out = self._in = None

    # What the robot says, in the robot's thread

    def _hear(self, message: Mapping[str, Any]) -> None:
        publishers, commands = self._out, self._in
        if (why := message.get("lost")) is not None:
            self.get_logger().warning(why, throttle_duration_sec=1.0)
        if not self.is_active or publishers is None or commands is None or not rclpy.ok():
            return
        if (motion := message.get("motion")) is not None:
            publishers.motion(motion)
        elif (status := message.get("status")) is not None:
            publishers.status(status, commands.figures)
        elif why is not None:
            publishers.lost(why, *divmod(self.get_clock().now().nanoseconds, 1_000_000_000))

    # Services

    async def _serve(self, action: Action, _: Any, response: Any) -> Any:
        assert self._robot is not None
        answer = Future(executor=self.executor)
        self._robot.order(action, {}, answer.set_result)
        refused = await answer
        response.success, response.message = refused is None, refused or f"{action.value} was accepted"
        return response


def run_served(scenario: Scenario, service: Callable[[], tuple[OwnService | None, Any]], ros: Sequence[str]) -> None:
    """Be the node of a robot behind a service, until a signal. ``service`` starts or finds it, and gives its client.

    Raises HilError when the service ends by itself.
    """

    def make(node: RobotNode) -> Robot:
        own, client = service()
        return ServedRobot(client, node.settings.publish_rate_hz, own)

    _run(scenario, make, ros)


def run_simulated(load: Callable[[Sequence[str]], Scenario], ros: Sequence[str]) -> None:
    """Be the node of a simulated robot, and its simulator, until a signal.

    ``load`` loads the scenario with further ``--set``. Raises HilError when the plant fails.
    """

    # The node says to whom it concerns which order was refused; the log would repeat it.
    logs.configure("text", "simulation")
    logging.getLogger(logs.__name__.rpartition(".")[0]).addFilter(lambda line: line.getMessage() != "order refused")

    def make(node: RobotNode) -> Robot:
        settings = node.settings
        pace = Pace(settings.real_time_factor, settings.wait_for_wheels_s, settings.publish_rate_hz)
        start = Pose(*settings.spawn_pose) if settings.spawn_pose else None
        simulation = Simulation(lambda pose: load(start_at(pose)), start, pace, ClockPublisher(node))
        simulation.pause(paused=settings.start_paused)
        Simulator(node, simulation, settings.odom_frame_id)
        return simulation

    _run(load([]), make, ros)


def _run(scenario: Scenario, make: Callable[[RobotNode], Robot], ros: Sequence[str]) -> None:
    # Not rclpy's handlers: they would end publishers before the robot's thread has ended.
    rclpy.init(args=["hil", *ros], signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    robot: Robot | None = None
    try:
        node = RobotNode(scenario)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        robot = make(node)
        node.use(robot)
        while rclpy.ok():
            executor.spin_once(timeout_sec=_LOOK_S)
            if (failure := robot.failure()) is not None:
                raise failure
    except KeyboardInterrupt:
        return
    finally:
        if robot is not None:
            robot.close()
        rclpy.try_shutdown()
