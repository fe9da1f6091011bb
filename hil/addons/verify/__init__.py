"""``hil verify``: how much a green run of a suite is worth. Known defects are put in, one at a time.

``catalogue.py`` reads the catalogue, ``mutants/*.toml``, a file a room. ``suite.py`` has the scenarios and test files
of a suite. ``verify.py`` says which is run next, ``run.py`` runs it in a worker process, and ``suggest.py`` finds the
expectation that would have noticed a survivor. ``results.py`` has JSON and lines of it all. To add a mutant: a row of
the file of its room.
"""

from hil.core.extensions import Command

COMMANDS = {
    "verify": Command(
        "Compare and repeat",
        "hil.addons.verify.verify_command:verify",
        "Put known defects into a suite of tests, one at a time, and say which it notices; exit 1 when one survives.",
    ),
}
