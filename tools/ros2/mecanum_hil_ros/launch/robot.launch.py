"""A robot in real time: a board behind a link, or a virtual one in a process of its own."""

from mecanum_hil_ros.launching import flag
from mecanum_hil_ros.launching import launch_description
from mecanum_hil_ros.launching import option


def generate_launch_description():
    """Return the node, robot_state_publisher and RViz, if asked for."""
    arguments = {
        'config': (None, 'scenario of mecanum-hil for hil serve: a shipped name or a .toml file'),
        'link': ('', "where the robot is, such as serial:/dev/ttyACM0; by default the config's"),
        'port': ('', 'of a hil serve that runs already; by default the node starts one'),
        'allow_motion': ('false', 'true: real motors may move'),
        'rviz': ('false', 'whether to open RViz: true or false'),
    }
    return launch_description(arguments, _words, simulated=False)


def _words(values):
    return [
        '--mode', 'realtime',
        *option('--link', values['link']),
        *option('--port', values['port']),
        *flag('--allow-motion', values['allow_motion']),
    ]
