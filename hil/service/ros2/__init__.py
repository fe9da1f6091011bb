"""A robot of ours as a ROS 2 node (ROS2.md). Only this package imports rclpy, and late: hil works without ROS 2."""
