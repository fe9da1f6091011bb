"""``hil doctor --clean``: what hil has left outside of the folders that a user names, and its removal.

Recordings, results, and the audit logs of services are evidence and stay.
"""

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from platformdirs import user_cache_path

from hil.core.errors import BadInputError
from hil.core.process_lock import free_locks, remove_lock
from hil.core.scratch import left_folders, remove_left
from hil.core.tokens import left_tokens, state_folder
from hil.service.discovery import running


class Leftover(NamedTuple):
    """A file or folder of ours that nothing uses, and what it is."""

    path: Path
    what: str
    remove: Callable[[Path], Any]


def leftovers() -> Iterator[Leftover]:
    """Yield what may be removed: nothing that a process uses, nothing that is evidence. Raises as ``state_folder``."""
    for cache in dict.fromkeys((user_cache_path("mecanum-hil"), user_cache_path("mecanum-hil", appauthor=False))):
        if cache.is_dir():
            yield Leftover(cache, "cache of what was built for this machine; made again when needed", shutil.rmtree)
    for folder in left_folders():
        yield Leftover(folder, "temporary folder of a killed process", remove_left)
    # Those of receivers of pose fixes are kept from one run to the next.
    for kind, kept in (("services", [service.port for service in running()]), ("truth", [])):
        for path in left_tokens(kind, kept):
            yield Leftover(path, "token of a killed server", Path.unlink)
    for kind in ("locks", "services"):
        for path in free_locks(state_folder(kind)):
            yield Leftover(path, "lock that nobody holds", remove_lock)


def clean(*, sure: bool) -> tuple[list[Leftover], bool]:
    """Remove what is left after a yes, or where ``sure``; return what was found, and whether it was removed.

    Raises BadInputError when nobody can be asked, and when something cannot be removed.
    """
    found = list(leftovers())
    for one in found:
        print(f"{one.path}  {one.what}", file=sys.stderr)
    if not found:
        return found, False
    if not sure:
        if not sys.stdin.isatty():
            raise BadInputError("nothing was removed: stdin is not a terminal; add --yes")
        print(f"Remove these {len(found)}? [y/N] ", end="", file=sys.stderr, flush=True)
        if sys.stdin.readline().strip().lower() not in ("y", "yes"):
            return found, False
    for one in found:
        try:
            one.remove(one.path)
        except FileNotFoundError:  # somebody else has removed it
            continue
        except OSError as error:
            raise BadInputError(f"{one.path} cannot be removed ({error.strerror}); remove it yourself") from error
    return found, True
