"""One process per device: who drives a robot holds a lock named after the device, however its URL is spelt.

The lock holds for the whole machine, so that it also keeps out another user's process.
"""

import contextlib
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import LinkError
from hil.wire.link import LinkUrl

if TYPE_CHECKING:
    from hil.core.process_lock import LockHeldError


@contextlib.contextmanager
def device_held(url: LinkUrl, command: str) -> Iterator[None]:
    """Hold the lock on a link's device for the body of a ``with``; other processes are told ``command`` as its holder.

    Raises LinkError with the holder's name and process id when another process holds it.
    """
    name = url.device_name()
    if name is None:
        yield
        return
    from hil.core.process_lock import LockHeldError, ProcessLock  # only for a device: most runs have none

    folder = _folder()
    record = {"pid": os.getpid(), "command": command, "since": f"{datetime.now():%Y-%m-%d %H:%M:%S}"}  # noqa: DTZ005
    try:
        _make_for_all(folder)
        # Any user may lock: in the temporary folder itself only its owner may open a file for writing.
        claim = ProcessLock(folder, _file_name(name), record, mode=0o666)
    except LockHeldError as taken:
        raise LinkError(_refusal(str(url), taken)) from None
    except OSError as error:
        raise LinkError(
            f"link {str(url)!r}: the lock that keeps other processes from the device cannot be taken "
            f"({error.strerror}); make sure that {folder} can be written"
        ) from error
    try:
        yield
    finally:
        claim.release()


def _refusal(link: str, taken: "LockHeldError") -> str:
    holder = taken.holder
    if not holder:
        return f"link {link!r}: another process is starting or ending its use of the device; try again"
    served = str(holder["command"]).startswith("hil serve")
    remedy = "drive it with 'hil ctl', or end it with 'hil ctl shutdown'" if served else "wait for its end, or end it"
    return (
        f"link {link!r}: {holder['command']!r} (process {holder['pid']}) has had the device since {holder['since']}; "
        f"{remedy}"
    )


def _file_name(device: str) -> str:
    """Return a legible file name, with a hash because it cannot hold every character of a device's name."""
    digest = hashlib.sha256(device.encode("utf-8", "surrogateescape")).hexdigest()[:8]
    return f"{re.sub('[^A-Za-z0-9_.-]', '_', device).strip('_')[-60:]}-{digest}"


def _make_for_all(folder: Path) -> None:
    """Make the folder, writable for every user. Raises OSError, also if a symbolic link stands in its place."""
    try:
        folder.mkdir(parents=sys.platform == "win32")
    except FileExistsError:
        # Any user may have made it. Changing the mode through a symbolic link could open up another folder.
        if folder.is_symlink() or not folder.is_dir():
            raise
    else:
        folder.chmod(0o777)  # whatever the umask


def _folder() -> Path:
    """Return the folder that all users of this machine share."""
    if sys.platform == "win32":
        from platformdirs import site_data_path

        return site_data_path("mecanum-hil", appauthor=False) / "locks"
    # Not TMPDIR, which may be private to a user, nor /run/lock, which only root may write on newer systems. /tmp may be
    # private to a systemd unit, or read-only; Linux has /dev/shm, a folder in memory that is neither.
    shared = Path("/dev/shm")
    return (shared if shared.is_dir() else Path("/tmp")) / "mecanum-hil-locks"
