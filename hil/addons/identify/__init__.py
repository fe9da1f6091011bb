"""Makes a plant that predicts the user's own robot: plans drives, and fits parameters to their recordings.

May import: `runtime`, `review`, `scenario`, `plant`, `core`.
IDENTIFY.md is for the user, METHOD.md has equations and accuracies. To add a parameter: a row in `RIGID` or `SLIP` of
`before.py`.
"""

from hil.core.extensions import Command

COMMANDS = {
    "commission": Command(
        "Your robot",
        "hil.addons.identify.identify_command:commission",
        "Find out, step by step, how a robot is wired, on blocks and on the floor, and write it into its file.",
    ),
    "identify": Command(
        "Your robot",
        "hil.addons.identify.identify_command:app",
        "Drive your robot so that it shows what it is made of, and fit a plant to the recordings.",
    ),
}
