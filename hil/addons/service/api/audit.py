"""The audit log of a service: each order with its time, client and outcome. One JSON object a line.

An order has two lines with the same number: ``given`` before it goes to the control process (an emergency stop goes
first), and then its outcome. One write hands each line to the operating system, so it survives a kill of any process
here. Within a second it is on the disk, and survives a loss of power.

Twists, stops and orders that were not sent may come in series. Lines of one series that are alike are summed up within
a second: the first is written at once, and ``count`` of the next says how many there were since.
"""

import asyncio
import contextlib
import errno
import json
import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.addons.service import logs
from hil.addons.service.api.access import Client
from hil.addons.service.messages import Action
from hil.core.errors import BadInputError, remedy

_SYNC_S = 1.0
_LONGEST_ARGUMENTS = 2000  # characters as JSON: a line a second with a body of 64 KiB would fill the files
_FLAGS = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
_FLAGS |= getattr(os, "O_NONBLOCK", 0)  # of a pipe, which is refused


@dataclass
class _Series:
    """Lines that are alike: the newest, and how many of them were not written yet."""

    record: Mapping[str, Any]
    unwritten: int = 0


class Audit:
    """Appends to a file that only this user may read.

    At ``longest_bytes`` the file is renamed to FILE.1, that to FILE.2, and so on; ``kept`` of these are kept. A file
    that another program has renamed is begun anew. Raises BadInputError when the file cannot be opened.

    Attributes:
        failures: number of lines that could not be written. The order is carried out nevertheless: a full disk must not
            take the robot from its operator.
    """

    def __init__(self, path: Path, longest_bytes: int = 10_000_000, kept: int = 9) -> None:
        self._path = path
        self._longest_bytes = longest_bytes
        self._kept = kept
        self._series: dict[tuple[object, ...], _Series] = {}
        self._older: list[int] = []
        self._cut = self._unsynced = False
        self.failures = 0
        try:
            self._descriptor = self._opened()
        except OSError as error:
            raise BadInputError(
                f"audit log {path}: it cannot be written ({error.strerror}); "
                + remedy(error, "name another by --audit")
            ) from error

    def note(
        self,
        client: Client,
        action: Action,
        outcome: str,
        *,
        number: int | None = None,
        arguments: Mapping[str, Any] | None = None,
        why: str | None = None,
        in_series: bool = False,
    ) -> None:
        """Write what became of an order; ``number`` is the one that it has on the way to the control process."""
        values = {"order": number, "action": action.value, "outcome": outcome, "token": client.name}
        shown, cut = _cut(arguments)
        record = values | {"client": client.address, "arguments": shown, "arguments_cut": cut, "why": why}
        if not in_series:
            self._write(record)
            return
        key = (action, outcome, client.name, client.address.rpartition(":")[0])
        if (series := self._series.get(key)) is None:
            self._series[key] = _Series(record)
            self._write(record)
        else:
            series.record, series.unwritten = record, series.unwritten + 1

    async def keep(self) -> None:
        """Write the sums of series and have the disk take all, once a second until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(_SYNC_S)
            self._sum_up()
            if self._unsynced:
                try:
                    newest = os.dup(self._descriptor)
                except OSError as error:  # no descriptor is left; it tries again
                    logs.error("audit log is not on the disk", path=self._path, why=error.strerror or str(error))
                    continue
                self._unsynced = False
                descriptors, self._older = [*self._older, newest], []
                await loop.run_in_executor(None, _sync, descriptors)  # a disk may take long

    def close(self) -> None:
        """Write what is left, and close the file."""
        self._sum_up()
        _sync([*self._older, self._descriptor])

    def _sum_up(self) -> None:
        for key, series in list(self._series.items()):
            if not series.unwritten:
                del self._series[key]
                continue
            self._write({**series.record, "count": series.unwritten})
            series.unwritten = 0

    def _write(self, record: Mapping[str, Any]) -> None:
        time = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        known = {name: value for name, value in record.items() if value is not None}
        line = json.dumps({"time": time} | known).encode() + b"\n"
        try:
            with contextlib.suppress(OSError):  # the file stays the same, and the line is not lost
                self._turn_over()
            whole = b"\n" + line if self._cut else line  # the last write was cut short
            written = os.write(self._descriptor, whole)
            self._cut = written < len(whole)
            if self._cut:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self.failures += 1
            logs.error("audit log cannot be written", path=self._path, why=error.strerror or str(error))
        self._unsynced = True

    def _turn_over(self) -> None:
        """Begin a new file when this one is full, or is no longer the one of this name. Raises OSError.

        Windows renames no file that is open: there it grows.
        """
        own = os.fstat(self._descriptor)
        try:
            named = self._path.lstat()
            is_ours = os.path.samestat(own, named)
        except FileNotFoundError:
            is_ours = False
        if is_ours and own.st_size < self._longest_bytes:
            return
        if is_ours:
            # From the first free number only: where FILE itself cannot be renamed, the kept ones stay.
            free = (number for number in range(1, self._kept) if not self._numbered(number).exists())
            for number in range(next(free, self._kept), 0, -1):
                older = self._numbered(number - 1)
                if older.exists():
                    older.replace(self._numbered(number))
        newer = self._opened()
        self._older.append(self._descriptor)
        self._descriptor = newer

    def _numbered(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.name}.{number}") if number else self._path

    def _opened(self) -> int:
        descriptor = os.open(self._path, _FLAGS, 0o600)
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise OSError(errno.EINVAL, "it is no regular file")
            if hasattr(os, "fchmod"):
                os.fchmod(descriptor, 0o600)
        except OSError:
            os.close(descriptor)
            raise
        return descriptor


def _cut(arguments: Mapping[str, Any] | None) -> tuple[Mapping[str, Any] | str | None, int | None]:
    """Return arguments as they are; of long ones the beginning of their JSON, and the number of characters cut."""
    text = json.dumps(arguments or None)
    if len(text) <= _LONGEST_ARGUMENTS:
        return arguments or None, None
    return text[:_LONGEST_ARGUMENTS], len(text) - _LONGEST_ARGUMENTS


def _sync(descriptors: Sequence[int]) -> None:
    """Have the disk take what was written to files, and close them."""
    for descriptor in descriptors:
        with contextlib.suppress(OSError):  # a full disk is reported by the next write
            os.fsync(descriptor)
        os.close(descriptor)
