"""Where recordings go that nobody named: ``runs/`` in the working directory, by name and time."""

from datetime import datetime
from pathlib import Path

from hil.errors import BadInputError


def new_in_runs(name: str, suffix: str, remedy: str) -> Path:
    """Return a new path in ``runs/``, which is made. Raises BadInputError, with ``remedy``, when it cannot be."""
    folder = Path("runs")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"recording folder {folder.absolute()}: it cannot be made ({error.strerror}); {remedy}"
        ) from error
    return folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}{suffix}"  # noqa: DTZ005 - the user's own time
