"""Files from strangers: whether code that a file names, or is, may be run.

A scenario may name a law in a Python file and a plant in an FMU, which is a native library. ``hil --no-code`` refuses
both, in this process and in those that it starts.
"""

import os

from hil.core.errors import BadInputError

_VARIABLE = "HIL_NO_CODE"


def refuse_code() -> None:
    """Refuse code of files from now on."""
    os.environ[_VARIABLE] = "1"


def code_is_refused() -> bool:
    """Return whether code of files is refused."""
    return os.environ.get(_VARIABLE, "") not in ("", "0")


def check_may_run(what: str) -> None:
    """Raise BadInputError, whose message begins with ``what``, where code of files is refused."""
    if code_is_refused():
        raise BadInputError(
            f"{what}: it is code, and --no-code (or {_VARIABLE} in the environment) refuses what does not come with "
            "this package or an installed one; leave it out if you trust the file"
        )
