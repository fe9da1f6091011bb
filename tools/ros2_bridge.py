"""A ROS 2 node for a robot that ``hil serve`` runs: /cmd_vel in; /odom, /tf and /joint_states out.

A process of its own, where ROS 2 is installed and this package beside it (Python 3.11 or newer, as ROS 2 Jazzy has)::

    hil serve my_robot.toml --allow-motion &
    hil ctl arm
    python -m tools.ros2_bridge --base-frame base_footprint --ros-args -r cmd_vel:=/robot/cmd_vel

A twist that comes is sent on at once and times out in the service (``service.twist_timeout_s``), so it must come at 20
to 50 Hz, and when this process or the network fails the robot stops. It arms nothing. The rest comes at the rate of the
service's status, 20 Hz, with the service's own time.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, HilError
from hil.service.client import Live, find
from hil.service.messages import Action
from tools.ros2_messages import Deviations, Names, Values, joint_states, odometry, transform, twist_arguments

Publish = Callable[[str, Values], None]
_SPIN_S = 0.005


class Bridge:
    """What goes in and out, without rclpy: ``publish`` gets a topic and a message's values, ``warn`` a sentence."""

    def __init__(
        self, live: Live, names: Names, deviations: Deviations, publish: Publish, warn: Callable[[str], None]
    ) -> None:
        self._live = live
        self._names = names
        self._deviations = deviations
        self._publish = publish
        self._warn = warn

    def drive(self, twist: Any) -> None:
        """Send a geometry_msgs/msg/Twist on; one with numbers that are not finite is dropped, with a warning."""
        try:
            self._live.order(Action.TWIST, twist_arguments(twist))
        except BadInputError as error:
            self._warn(str(error))

    def receive(self, within_s: float) -> bool:
        """Publish one status, or warn of one refusal; return whether anything came. Raises LinkError."""
        message = self._live.receive(within_s)
        if message is None:
            return False
        if "answer" in message:
            if message["answer"]["refused"] is not None:
                self._warn(f"refused: {message['answer']['refused']}")
            return True
        status = message["status"]
        for topic, values in (
            ("odom", odometry(status, self._names, self._deviations)),
            ("/tf", transform(status, self._names)),
            ("joint_states", joint_states(status, self._names)),
        ):
            if values is not None:
                self._publish(topic, values)
        return True


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """Return what the command line says, without what is meant for ROS."""
    names, deviations = Names(), Deviations()
    parser = argparse.ArgumentParser(description="A ROS 2 node for a robot that hil serve runs.")
    parser.add_argument("--url", help="http://127.0.0.1:PORT of the service; by default the only one that runs")
    parser.add_argument("--port", type=int, help="which service, when several run")
    parser.add_argument("--token-file", type=Path, help="with the token; by default the service's own")
    parser.add_argument("--odom-frame", default=names.odom)
    parser.add_argument("--base-frame", default=names.base)
    parser.add_argument("--joints", nargs=4, default=names.joints, metavar=("FL", "FR", "RR", "RL"))
    parser.add_argument(
        "--deviations",
        nargs=4,
        type=float,
        default=deviations,
        metavar=("M", "RAD", "M_S", "RAD_S"),
        help="standard deviations of pose and twist",
    )
    return parser.parse_args(arguments)


def main() -> None:
    """Be the node until Ctrl-C, or until the service ends. Raises LinkError and BadInputError."""
    try:
        import rclpy
        from geometry_msgs.msg import Twist
        from nav_msgs.msg import Odometry
        from rclpy.executors import ExternalShutdownException
        from rclpy.utilities import remove_ros_args
        from rosidl_runtime_py.set_message import set_message_fields
        from sensor_msgs.msg import JointState
        from tf2_msgs.msg import TFMessage
    except ImportError as error:
        raise BadInputError(
            f"ROS 2 is not there for this Python ({error}); source its setup.bash, and use the Python it was made for"
        ) from error

    asked = options(remove_ros_args(sys.argv)[1:])
    with find(asked.url, asked.port, asked.token_file).live() as live:
        rclpy.init(args=sys.argv)
        node = rclpy.create_node("mecanum_hil")
        kinds = {"odom": Odometry, "/tf": TFMessage, "joint_states": JointState}
        publishers = {topic: node.create_publisher(kind, topic, 10) for topic, kind in kinds.items()}

        def publish(topic: str, values: Values) -> None:
            message = kinds[topic]()
            set_message_fields(message, values)
            publishers[topic].publish(message)

        names = Names(asked.odom_frame, asked.base_frame, tuple(asked.joints))
        warn = node.get_logger().warning
        bridge = Bridge(live, names, Deviations(*asked.deviations), publish, warn)
        # Of twists that came meanwhile only the newest counts.
        node.create_subscription(Twist, "cmd_vel", bridge.drive, 1)
        try:
            while rclpy.ok():
                rclpy.spin_once(node, timeout_sec=_SPIN_S)
                while bridge.receive(0.0):
                    pass
        except (KeyboardInterrupt, ExternalShutdownException):
            return
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


if __name__ == "__main__":
    try:
        main()
    except HilError as error:
        print(f"ros2_bridge: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
