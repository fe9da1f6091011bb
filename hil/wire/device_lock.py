"""One process per device: who drives a robot holds a lock named after the device, however its URL is spelt.

There are two locks. ``device_held`` is for the processes of one user: it is held for as long as they drive, also while
the link is lost, and names its holder to them. ``claim_file`` locks an open device itself, because others could hold or
remove a lock file. It keeps out all other users of the device. A serial port is locked
likewise by pyserial when it is opened. A CAN interface of Linux has no file of its own: its ``type`` under /sys stands
for it, which every user may lock, as every user may send on it too.
"""

import contextlib
import hashlib
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import LinkError
from hil.wire.link import LinkUrl
from hil.wire.serial_failures import BUSY

if TYPE_CHECKING:
    from hil.core.process_lock import LockHeldError, ProcessLock


@contextlib.contextmanager
def device_held(url: LinkUrl, command: str) -> Iterator[None]:
    """Hold this user's lock on a link's device for the body of a ``with``; others see ``command`` as its holder.

    Raises LinkError with the holder's name and process id when another process of this user holds it.
    """
    name = url.device_name()
    if name is None:
        yield
        return
    from hil.core.process_lock import LockHeldError  # only for a device: most runs have none

    try:
        claim = _locked(url, name, command)
    except LockHeldError as taken:
        raise LinkError(_refusal(str(url), taken)) from None
    try:
        yield
    finally:
        claim.release()


def _locked(url: LinkUrl, name: str, command: str) -> "ProcessLock":
    """Take the lock in the first folder that this user alone can use. Raises LockHeldError and LinkError."""
    from hil.core.private_files import private_folder
    from hil.core.process_lock import ProcessLock

    record = {"pid": os.getpid(), "command": command, "since": f"{datetime.now():%Y-%m-%d %H:%M:%S}"}  # noqa: DTZ005
    why = []
    for folder in _folders():
        try:
            return ProcessLock(private_folder(folder), _file_name(name), record)
        except OSError as error:
            why.append(f"{folder}: {error.strerror}")
    raise LinkError(
        f"link {str(url)!r}: the lock that keeps other processes from the device cannot be taken ({'; '.join(why)}); "
        "make one of these folders yours alone, with mode 0700"
    )


_claims: dict[str, tuple[int, int]] = {}  # for each file its descriptor and how many links of this process use it


def claim_file(path: str, device: str) -> Callable[[], None]:
    """Lock the file of an open device against other processes, and return what gives the lock back.

    The links of one process share the lock. A file that is not there or may not be read is not locked: opening the
    device says why. Nor is one on Windows, where a port and an adapter belong to the one who opens them. ``device``
    names the device in messages. Raises LinkError when another process holds the lock.
    """
    if sys.platform == "win32":
        return lambda: None
    import fcntl

    descriptor, users = _claims.get(path, (-1, 0))
    if not users:
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_NOFOLLOW)
        except OSError:
            return lambda: None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise LinkError(f"{device} {BUSY}") from error
        except OSError:  # a file that cannot be locked
            os.close(descriptor)
            return lambda: None
    _claims[path] = descriptor, users + 1

    def give_back() -> None:
        descriptor, users = _claims.pop(path)
        if users > 1:
            _claims[path] = descriptor, users - 1
        else:
            os.close(descriptor)

    return give_back


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
    """Return a legible file name, with a hash because it cannot hold every character of a device's name.

    The hash is also of this machine's name, because several machines may have one home folder.
    """
    digest = hashlib.sha256(f"{platform.node()}/{device}".encode("utf-8", "surrogateescape")).hexdigest()[:8]
    return f"{re.sub('[^A-Za-z0-9_.-]', '_', device).strip('_')[-60:]}-{digest}"


def _folders() -> Iterator[Path]:
    """Yield the folders for this user's locks, the best first.

    That is where the records of the user's services are, because it does not depend on whether the user has logged in.
    The others are for a user without a home.
    """
    from platformdirs import user_state_path

    yield user_state_path("mecanum-hil", appauthor=False) / "locks"
    if sys.platform != "win32":
        yield Path(f"/run/user/{os.getuid()}/mecanum-hil-locks")
        yield Path(f"/tmp/mecanum-hil-locks-{os.getuid()}")
