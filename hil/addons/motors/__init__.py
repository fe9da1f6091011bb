"""Motor controllers of other makers: a folder each, with a driver, an emulated device and a page; see README.md."""

from hil.core.extensions import Command

COMMANDS = {
    "probe": Command(
        "Your robot",
        "hil.addons.motors.probe_command:probe",
        "Find the motor controllers on a bus or a port, and print a robot file for them.",
    ),
}
