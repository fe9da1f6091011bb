"""Where recordings go that nobody named: ``runs/`` in the working directory, by name and time."""

from datetime import datetime
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.outputs import free_name


def new_in_runs(name: str, suffix: str, remedy: str) -> Path:
    """Return a path in ``runs/`` that is free; the folder is made.

    Raises BadInputError, with ``remedy``, when it cannot be.
    """
    folder = Path("runs")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"recording folder {folder.absolute()}: it cannot be made ({error.strerror}); {remedy}"
        ) from error
    return free_name(folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}{suffix}")  # noqa: DTZ005 - the user's own time
