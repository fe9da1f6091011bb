"""The extension module ``_wheel`` of the present sources, as ``wheel``, and cffi's view of the same file.

Where it cannot be loaded, ``wheel`` has the same names, and calling one raises BuildError with the reason: what needs
no run, such as ``hil doctor``, works without it.
"""

import functools
import hashlib
import importlib.util
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from firmware_protocol.built import OTHER, WHEEL_HOST, BuildError, digest_in_library
from firmware_protocol.declarations import HEADERS, TABLE, declared

__all__ = ["Loaded", "library", "load_library", "loaded", "wheel"]


class Loaded(NamedTuple):
    """A loaded native library.

    Attributes:
        ffi, library: cffi's objects. sha256: hash of the file, in hex. sources_sha256: hash of the sources that it was
            built from, None if the file holds none.
    """

    ffi: Any
    library: Any
    sha256: str
    sources_sha256: str | None


def library() -> tuple[Any, Any]:
    """Return cffi's (ffi, library), with the declarations taken from the C headers themselves.

    A library that does not match its sources is rebuilt in a checkout. Raises BuildError if that is not possible.
    """
    return loaded()[:2]


@functools.cache
def loaded() -> Loaded:
    """Load the library once, and return it with its hashes. Raises as ``library``, and in a Python without a GIL."""
    if sysconfig.get_config_var("Py_GIL_DISABLED"):
        raise BuildError("this Python has no GIL, and the extension module needs one; use the usual build of Python")
    if OTHER is None:
        WHEEL_HOST.make_current()
    path = WHEEL_HOST.path if OTHER is None else Path(OTHER)
    if not path.is_file():
        raise BuildError(f"{path} does not exist; build it, or unset WHEEL_HOST_LIBRARY")
    return load_library(path, HEADERS, TABLE)


def load_library(path: Path, headers: Iterable[Path], declarations: str = "") -> Loaded:
    """Load a library, with the declarations that C headers mark for cffi, and further ``declarations``."""
    ffi = declared(path, headers, declarations)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return Loaded(ffi, ffi.dlopen(str(path)), digest, digest_in_library(path))


if TYPE_CHECKING:
    import firmware_protocol._wheel as wheel
else:

    class _Absent:
        def __init__(self, reason: str) -> None:
            self._reason = reason

        def __getattr__(self, name: str) -> Any:
            def refuse(*_values: object) -> Any:
                raise BuildError(self._reason)

            return type(name, (), {"__new__": refuse})

    def _imported() -> Any:
        try:
            loaded()
        except BuildError as error:
            return _Absent(str(error))
        if OTHER is None:
            return importlib.import_module("firmware_protocol._wheel")
        spec = importlib.util.spec_from_file_location("firmware_protocol._wheel", OTHER)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    wheel = _imported()
