"""``hil init``: the files that test a user's own robot; its README says how to add a file or a question."""

from hil.core.extensions import Command

COMMANDS = {
    "init": Command(
        "Your robot",
        "hil.addons.init.init_command:init",
        "Write what tests your robot: its file, a law, scenarios, tests, a baseline and a CI workflow.",
    ),
}
