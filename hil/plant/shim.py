"""The compiled shim as cffi sees it: the plant port in front of an FMU here, or of one in another process."""

import functools
import re
from typing import Any

import cffi

from hil.errors import BadInputError
from hil.plant.build import HEADERS, LIBRARY

_SECTION = re.compile(r"/\* cffi: begin \*/(.*?)/\* cffi: end \*/", re.DOTALL)


@functools.cache
def shim() -> tuple[Any, Any]:
    """Return cffi's (ffi, library), with the declarations taken from the C headers themselves.

    Raises BadInputError when the library is not built.
    """
    if not LIBRARY.exists():
        raise BadInputError(f"{LIBRARY} is not built; run: python -m hil.plant.build")
    ffi = cffi.FFI()
    for header in HEADERS:
        for section in _SECTION.findall(header.read_text(encoding="utf-8")):
            ffi.cdef(section)
    return ffi, ffi.dlopen(str(LIBRARY))
