"""One process a device: who drives a robot holds a lock that goes by the device, not by the way it was spelt.

The lock is for the whole machine, so that another user's process is kept out too.
"""

import contextlib
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from platformdirs import site_data_path

from hil.core.errors import LinkError
from hil.core.process_lock import LockHeldError, ProcessLock
from hil.wire.link import LinkUrl


@contextlib.contextmanager
def device_held(url: LinkUrl, command: str) -> Iterator[None]:
    """Hold the device of a link for the body of a ``with``; ``command`` is how others are told who has it.

    Raises LinkError, naming the process that holds it, when another one does.
    """
    name = url.device_name()
    if name is None:
        yield
        return
    folder = _folder()
    record = {"pid": os.getpid(), "command": command, "since": f"{datetime.now():%Y-%m-%d %H:%M:%S}"}  # noqa: DTZ005
    try:
        _make_for_all(folder)
        # Anybody may lock: in the temporary folder itself a file may be opened for writing by its owner only.
        claim = ProcessLock(folder, _file_name(name), record, mode=0o666)
    except LockHeldError as taken:
        raise LinkError(_refusal(str(url), taken)) from None
    except OSError as error:
        raise LinkError(
            f"link {str(url)!r}: the lock that keeps a second process from the device cannot be taken "
            f"({error.strerror}); see to it that {folder} may be written to"
        ) from error
    try:
        yield
    finally:
        claim.release()


def _refusal(link: str, taken: LockHeldError) -> str:
    holder = taken.holder
    if not holder:
        return f"link {link!r}: another process is about to use the device, or to leave it; try again"
    served = str(holder["command"]).startswith("hil serve")
    remedy = "drive it with 'hil ctl', or end it with 'hil ctl shutdown'" if served else "wait for its end, or end it"
    return (
        f"link {link!r}: {holder['command']!r} (process {holder['pid']}) has had the device since {holder['since']}; "
        f"{remedy}"
    )


def _file_name(device: str) -> str:
    """Return a name for a file: legible, and different for devices that differ in what a file name cannot hold."""
    digest = hashlib.sha256(device.encode("utf-8", "surrogateescape")).hexdigest()[:8]
    return f"{re.sub('[^A-Za-z0-9_.-]', '_', device).strip('_')[-60:]}-{digest}"


def _make_for_all(folder: Path) -> None:
    """Make the folder so that every user may lock in it. Raises OSError, also where a link stands in its place."""
    try:
        folder.mkdir(parents=sys.platform == "win32")
    except FileExistsError:
        # Anybody may have put it there. To change the mode of what a link leads to would be to do his bidding.
        if folder.is_symlink() or not folder.is_dir():
            raise
    else:
        folder.chmod(0o777)  # whatever the umask


def _folder() -> Path:
    """Return the folder that all users of this machine agree on."""
    if sys.platform == "win32":
        return site_data_path("mecanum-hil", appauthor=False) / "locks"
    # Not TMPDIR, which may be a user's own, nor /run/lock, which is root's alone on newer systems. /tmp may be private
    # to a unit of systemd, or read-only; Linux has a folder in memory that is neither.
    shared = Path("/dev/shm")
    return (shared if shared.is_dir() else Path("/tmp")) / "mecanum-hil-locks"
