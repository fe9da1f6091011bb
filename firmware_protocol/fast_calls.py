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
# What the library gets of the stable ABI, in the order of ``wheel_python``.
_NEEDED = (
    "PyFloat_AsDouble",
    "PyLong_AsLongLong",
    "PyLong_AsLongLongAndOverflow",
    "PyLong_AsUnsignedLongLongMask",
    "PyErr_Occurred",
    "PyErr_Clear",
    "PyTuple_GetItem",
    "PySequence_GetItem",
    "PyTuple_New",
    "PyTuple_Size",
    "PyTuple_SetItem",
    "PyList_SetItem",
    "PyFloat_FromDouble",
    "PyLong_FromLongLong",
    "PyBool_FromLong",
    "PyEval_SaveThread",
    "PyEval_RestoreThread",
    "PyBytes_FromStringAndSize",
    "PyBytes_AsStringAndSize",
    "Py_DecRef",
    "Py_IncRef",
    "PyType_GenericAlloc",
    "PyErr_BadArgument",
    "_Py_NoneStruct",
)


class _Method(ctypes.Structure):
    """CPython's ``PyMethodDef``."""

    _fields_ = (
        ("ml_name", ctypes.c_char_p),
        ("ml_meth", ctypes.c_void_p),
        ("ml_flags", ctypes.c_int),
        ("ml_doc", ctypes.c_char_p),
    )


class Scaled(NamedTuple):
    """A number of a row that is multiplied by ``unit`` first."""

    name: str
    unit: float


Objects = tuple["str | Scaled | Objects | None", ...]
"""What the members of a tuple are: the name of a number, another tuple, or None for what is left out."""
_LEFT_OUT, _NESTED = -1, -2


class RowLayout:
    """Makes rows of numbers from nested tuples, in the host library.

    ``names`` are the columns of a row, in order. ``objects`` has the form of the arguments of ``row``: nested tuples
    with a column's name at the place of each number. None stands for a number that is left out; so does a name that is
    no column of these rows. A tuple without columns is not looked at, and may be None. ``difference`` names three
    columns, each the first of a group: two poses A and B (x, y, heading), and A minus B, computed here (x, y, heading
    in [-π, π], distance). A column that no argument has is NaN. Raises BuildError when the library cannot be loaded.

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
        self.row: Callable[..., bytes] = fast_call("row", layout, (members, numbers))


def _members(objects: Objects, places: Mapping[str, int]) -> Iterator[tuple[int, int, float]]:
    for member in objects:
        if member is None:
            yield _LEFT_OUT, 0, 1.0
        elif isinstance(member, str):
            yield places.get(member, _LEFT_OUT), 0, 1.0
        elif isinstance(member, Scaled):
            yield places.get(member.name, _LEFT_OUT), 0, member.unit
        else:
            inner = list(_members(member, places))
            if all(place == _LEFT_OUT for place, _, _ in inner):
                yield _LEFT_OUT, 0, 1.0
            else:
                yield _NESTED, len(member), 1.0
                yield from inner


def address_of(pointer: Any) -> int:
    """Return the address of a cffi pointer."""
    return int(library()[0].cast("uintptr_t", pointer))


def fast_call(name: str, owner: Any = None, keeps: object = None) -> Callable[..., Any]:
    """Return function ``wheel_python_NAME`` of the library, bound to the struct of a cffi pointer.

    ``fast_calls.h`` says what it takes and returns. It keeps ``owner`` alive, and ``keeps``: the memory that the struct
    is in or refers to. Raises BuildError when the library cannot be loaded.
    """
    method, make = _method(name)
    address = 0 if owner is None else address_of(owner)
    bound: Callable[..., Any] = make(ctypes.addressof(method), address, (owner, keeps))
    return bound


@functools.cache  # CPython keeps only the address of a method
def _method(name: str) -> tuple[_Method, Callable[..., Any]]:
    ffi, lib = _begun()
    start = address_of(ffi.addressof(lib, f"wheel_python_{name}"))
    make = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.py_object)
    return _Method(name.encode(), start, _FASTCALL, None), make(("PyCFunction_NewEx", ctypes.pythonapi))


@functools.cache
def _begun() -> tuple[Any, Any]:
    """Give the library CPython's functions, once; return cffi's objects of it."""
    ffi, lib = library()
    needed = {name: ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value for name in _NEEDED}
    lib.wheel_python_begin(ffi.new("wheel_python *", {name: ffi.cast("void *", at) for name, at in needed.items()}))
    return ffi, lib
