"""A robot of firmware and plant in lockstep: the node is the simulator, and publishes /clock."""

from mecanum_hil_ros.launching import launch_description


def generate_launch_description():
    """Return the node, robot_state_publisher and RViz, on simulated time."""
    arguments = {
        'config': ('circle_speed', 'scenario of mecanum-hil: a shipped name or a .toml file'),
        'rviz': ('true', 'whether to open RViz: true or false'),
    }
    return launch_description(arguments, lambda values: ['--mode', 'lockstep'], simulated=True)
