"""A recorded run as a test: the whole controller, or a law, repeated on what was recorded (README.md).

``recorded_robot.py`` takes the place of the robot, ``replay.py`` compares, ``law_replay.py`` is for a law alone.
"""

from hil.core.extensions import Command

COMMANDS = {
    "replay": Command(
        "Look",
        "hil.addons.replay.replay_command:replay",
        "Repeat a recorded run with the controller as it is now, and say what differs first; exit 1 if anything does.",
    ),
}
