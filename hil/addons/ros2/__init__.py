"""A robot of ours as a ROS 2 node (ROS2.md). Only this package imports rclpy, and late: hil works without ROS 2."""

from hil.core.extensions import Command

COMMANDS = {
    "ros2": Command(
        "Connect and drive",
        "hil.addons.ros2.ros2_command:ros2",
        "Be a ROS 2 node for a robot or its simulation: cmd_vel in; odometry, tf, joint states and more out.",
    ),
}
