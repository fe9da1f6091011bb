"""Functions of the host library that CPython calls as its own (``port/python/fast_calls.h``), for the calls of a tick.

A call through cffi takes 0.1 to 0.5 µs and converts each number by itself; these take a fifth of that or less. They
check neither the number of their arguments nor addresses: only this package calls them.
"""

import ctypes
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from firmware_protocol.host import library

_FASTCALL = 0x0080
# The functions of the stable ABI that the library gets, in the order of ``wheel_python``.
_NEEDED = (
    "PyFloat_AsDouble",
    "PyLong_AsLongLong",
    "PyLong_AsVoidPtr",
    "PyErr_Occurred",
    "PyTuple_GetItem",
    "PyTuple_New",
    "PyTuple_SetItem",
    "PyFloat_FromDouble",
    "PyLong_FromLongLong",
    "PyBool_FromLong",
    "PyEval_SaveThread",
    "PyEval_RestoreThread",
    "PyBytes_FromStringAndSize",
    "PyBytes_AsStringAndSize",
    "Py_DecRef",
    "Py_IncRef",
    "Py_BuildValue",
    "PyType_GenericAlloc",
)


class _Method(ctypes.Structure):
    """CPython's ``PyMethodDef``."""

    _fields_ = (
        ("ml_name", ctypes.c_char_p),
        ("ml_meth", ctypes.c_void_p),
        ("ml_flags", ctypes.c_int),
        ("ml_doc", ctypes.c_char_p),
    )


class FastCalls(NamedTuple):
    """The functions; ``fast_calls.h`` says what each takes and returns."""

    command: Callable[[int, Sequence[float], Sequence[float], int], int]
    poll: Callable[[int, int], bool]
    step: Callable[[int, int, int, int, int], bool]
    feedback: Callable[[int, type, type, tuple[Any, ...]], Any]
    link_figures: Callable[[int], tuple[float, float, float, float]]
    line_bytes: Callable[[int, int, float], tuple[float, float]]
    out: Callable[[int], bytes]
    sent: Callable[[int], int]
    ask: Callable[[int, int], bool]
    take: Callable[[int, bytes, int, int], int]
    receive: Callable[[int, int, bytes, int], "int | tuple[bytes, int]"]
    encode: Callable[[int, int], bytes]
    exchange: Callable[[int, int, int, bytes], bytes]
    split: Callable[[bytes, int], tuple[bytes, bytes]]
    row: Callable[..., bytes]


class Scaled(NamedTuple):
    """A number of a row that is multiplied by ``unit`` first."""

    name: str
    unit: float


Objects = tuple["str | Scaled | Objects | None", ...]
"""What the members of a tuple are: the name of a number, another tuple, or None for what is left out."""
_SKIP, _TUPLE = -1, -2


class RowLayout:
    """Makes rows of numbers from nested tuples, in the host library.

    ``names`` are the columns of a row, in order. ``objects`` has the form of the arguments of ``row``: nested tuples
    with a column's name at the place of each number, or None for what is left out. ``difference`` names three columns,
    each the first of a group: two poses A and B (x, y, heading), and A minus B, computed here (x, y, heading in
    [-π, π], distance). A column that no argument has is NaN. Raises BuildError when the library cannot be loaded.

    Attributes:
        row: the function that makes a row: doubles, as bytes.
    """

    def __init__(self, names: Sequence[str], objects: Objects, difference: tuple[str, str, str]) -> None:
        ffi, _ = library()
        places = {name: place for place, name in enumerate(names)}
        members = ffi.new("wheel_python_member[]", list(_members(objects, places)))
        numbers = ffi.new("double[]", [float("nan")] * len(names))
        first = [places[name] for name in difference]
        layout = ffi.new("wheel_python_layout *", (numbers, len(names), *first, members))
        self._memory = members, numbers, layout
        self.row: Callable[..., bytes] = functools.partial(fast_calls().row, address_of(layout))


def _members(objects: Objects, places: Mapping[str, int]) -> Iterator[tuple[int, int, float]]:
    for member in objects:
        if member is None:
            yield _SKIP, 0, 1.0
        elif isinstance(member, str):
            yield places[member], 0, 1.0
        elif isinstance(member, Scaled):
            yield places[member.name], 0, member.unit
        else:
            yield _TUPLE, len(member), 1.0
            yield from _members(member, places)


def address_of(pointer: Any) -> int:
    """Return the address of a cffi pointer."""
    return int(library()[0].cast("uintptr_t", pointer))


@functools.cache
def fast_calls() -> FastCalls:
    """Return the functions. Raises BuildError when the host library cannot be loaded."""
    ffi, lib = library()
    needed = {name: ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value for name in _NEEDED}
    lib.wheel_python_begin(ffi.new("wheel_python *", {name: ffi.cast("void *", at) for name, at in needed.items()}))
    make = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)(
        ("PyCFunction_NewEx", ctypes.pythonapi)
    )
    functions = []
    for name in FastCalls._fields:
        start = address_of(ffi.addressof(lib, f"wheel_python_{name}"))
        method = _Method(name.encode(), start, _FASTCALL, None)
        _kept.append(method)
        functions.append(make(ctypes.addressof(method), None, None))
    return FastCalls(*functions)


_kept: list[_Method] = []  # CPython keeps only their addresses
