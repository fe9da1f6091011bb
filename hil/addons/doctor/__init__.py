"""``hil doctor``: functions that yield findings about this machine. They change nothing and open no port.

A check that does not apply to the operating system yields nothing. To add one: a function in ``checks.py``, named in
``doctor_command.py``. Another add-on adds a check by an entry point of the group ``hil.checks``.
"""

from hil.core.extensions import Command

COMMANDS = {
    "doctor": Command(
        "Tools",
        "hil.addons.doctor.doctor_command:doctor",
        "Check this machine and print remedies; exit 1 when there is a problem.",
    ),
}
