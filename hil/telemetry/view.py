"""Opening the rerun viewer: on a recording, or on a run that is under way."""

import importlib.util
import shutil
import sys
from pathlib import Path

from hil.errors import DeviceError


def viewer_executable() -> Path:
    """Return the viewer that came with rerun-sdk, or else a ``rerun`` on the path.

    Raises DeviceError when there is neither.
    """
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    package = importlib.util.find_spec("rerun_cli")
    for directory in (package.submodule_search_locations or []) if package else []:
        bundled = Path(directory) / name
        if bundled.is_file():
            return bundled
    found = shutil.which("rerun")
    if found is None:
        raise DeviceError("the rerun viewer was not found: install it with 'pip install rerun-sdk==0.41.*'")
    return Path(found)
