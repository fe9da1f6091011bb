"""The node ``mecanum_hil``: a robot of ours as ROS 2 sees it (ROS2.md). It imports ROS 2."""

import logging
import signal
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from hil.addons.ros2.robot import OwnService, ServedRobot
from hil.addons.ros2.settings import Settings
from hil.addons.ros2.simulation import Simulation
from hil.addons.ros2.topics import Commands, Publishers
from hil.addons.service import logs
from hil.addons.service.messages import Action
from hil.scenario import Scenario

NAME = "mecanum_hil"
_ORDERS = (Action.ARM, Action.DISARM, Action.ESTOP, Action.CLEAR, Action.STOP)
_LOOK_S = 0.2


class RobotNode(Node):  # type: ignore[misc]
    """The node of a scenario's robot. ``settings`` are its parameters."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(NAME)
        self._scenario = scenario
        self.settings = Settings.declared(self)

    def use(self, robot: ServedRobot | Simulation) -> None:
        """Be the node of a robot: make topics and services, and begin to publish."""
        self._robot = robot
        self._outgoing = Publishers(self, self.settings)
        self._incoming = Commands(self, self.settings, self._scenario, robot)
        for action in _ORDERS:
            self.create_service(Trigger, f"~/{action.value}", partial(self._serve, action))
        robot.start(self._hear)

    def _hear(self, message: Mapping[str, Any]) -> None:
        """Publish what the robot says, in the robot's thread."""
        if (why := message.get("lost")) is not None:
            self.get_logger().warning(why, throttle_duration_sec=1.0)
        if not rclpy.ok():
            return
        if (motion := message.get("motion")) is not None:
            self._outgoing.motion(motion)
        elif (status := message.get("status")) is not None:
            self._outgoing.status(status, self._incoming.figures)
        elif why is not None:
            self._outgoing.lost(why, *divmod(self.get_clock().now().nanoseconds, 1_000_000_000))

    async def _serve(self, action: Action, _: Any, response: Any) -> Any:
        answer = Future(executor=self.executor)
        self._robot.order(action, {}, answer.set_result)
        refused = await answer
        response.success, response.message = refused is None, refused or f"{action.value} was accepted"
        return response


def run_served(scenario: Scenario, service: Callable[[], tuple[OwnService | None, Any]], ros: Sequence[str]) -> None:
    """Be the node of a robot behind a service, until a signal. ``service`` starts or finds it, and gives its client.

    Raises HilError when the service ends by itself.
    """

    def make(node: RobotNode) -> ServedRobot:
        own, client = service()
        return ServedRobot(client, node.settings.publish_rate_hz, own)

    _run(scenario, make, ros)


def run_simulated(scenario: Scenario, ros: Sequence[str]) -> None:
    """Be the node of a simulated robot, until a signal. Raises HilError when the plant fails."""
    # The node says to whom it concerns which order was refused; the log would repeat it.
    logs.configure("text", "simulation")
    logging.getLogger(logs.NAME).addFilter(lambda line: line.getMessage() != "order refused")

    def make(node: RobotNode) -> Simulation:
        # As every simulator does: the newest time only, none sent again.
        clock = node.create_publisher(Clock, "clock", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))

        def on_time(now_ns: int) -> None:
            sec, nanosec = divmod(now_ns, 1_000_000_000)
            clock.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))

        return Simulation(scenario, node.settings, on_time)

    _run(scenario, make, ros)


def _run(scenario: Scenario, make: Callable[[RobotNode], ServedRobot | Simulation], ros: Sequence[str]) -> None:
    # Not rclpy's handlers: they would end publishers before the robot's thread has ended.
    rclpy.init(args=["hil", *ros], signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    robot: ServedRobot | Simulation | None = None
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
