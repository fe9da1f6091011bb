"""The robot of mecanum-hil in ROS 2: how it is launched."""
