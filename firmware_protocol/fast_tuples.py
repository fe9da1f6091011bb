"""Makes named tuples in the host library, in a fraction of the time that it takes in Python.

``Tuple`` describes one: its values are arguments, objects, and numbers in the memory of C structs.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from firmware_protocol.fast_calls import address_of, fast_call
from firmware_protocol.host import library

_NUMBERS = {"float": "FLOAT", "double": "DOUBLE", "uint8_t": "UINT8", "uint16_t": "UINT16", "uint64_t": "UINT64"}


class Argument(NamedTuple):
    """The next argument of the function that makes the tuple."""


class Object(NamedTuple):
    """Always this object."""

    object: object


class Number(NamedTuple):
    """A number in memory, by its address and C type; a ``uint64_t`` is multiplied by ``factor``."""

    address: int
    c_type: str
    factor: int = 1


class Choice(NamedTuple):
    """One of ``objects``, by a ``uint8_t`` in memory that is its place among them."""

    address: int
    objects: tuple[Any, ...]


class Tuple(NamedTuple):
    """A tuple of values: of a class of named tuples, or a plain one."""

    kind: type | None
    values: "tuple[Argument | Object | Number | Choice | Kept | Tuple, ...]"


class Kept(NamedTuple):
    """A tuple of numbers that lie one behind the other in memory, 16 bytes at most.

    While they stay the same it is the same tuple: for what changes in few of the calls.
    """

    tuple: Tuple


def fields_of(ffi: Any, struct: Any, name: str, first: int = 0, count: int | None = None) -> tuple[Number, ...]:
    """Return the numbers of a field of the struct that a cffi pointer is of; of an array all, or ``count`` of them."""
    field = dict(ffi.typeof(struct).item.fields)[name]
    is_array = field.type.kind == "array"
    item, length = (field.type.item, field.type.length) if is_array else (field.type, 1)
    begin, size = address_of(struct) + field.offset, ffi.sizeof(item)
    end = length if count is None else first + count
    return tuple(Number(begin + place * size, item.cname) for place in range(first, end))


def numbers_at(ffi: Any, array: Any) -> tuple[Number, ...]:
    """Return the doubles of an array that cffi owns."""
    begin, size = address_of(array), ffi.sizeof("double")
    return tuple(Number(begin + place * size, "double") for place in range(len(array)))


def tuple_constructor(what: Tuple, memory: object = None, given: Number | None = None) -> Callable[..., Any]:
    """Return a function that makes the tuple. It takes the arguments in their order, and reads numbers as they are now.

    While the bool ``given`` is false it returns None. It keeps ``memory`` alive, the owner of the numbers. Called with
    another number of arguments it raises TypeError. Raises BuildError when the library cannot be loaded.
    """
    ffi, lib = library()
    kept: list[object] = []
    values = ffi.new("wheel_python_value[]", list(_flat(what, kept)))
    values[0].factor = sum(value.kind == lib.WHEEL_PYTHON_ARGUMENT for value in values)
    if given is not None:
        values[0].at = ffi.cast("void *", given.address)
    return fast_call("make", values, (what, memory, kept))


def _flat(value: Argument | Object | Number | Choice | Kept | Tuple, kept: list[object]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a value; ``kept`` gets the memory that they refer to."""
    ffi, lib = library()

    def row(kind: str, *, at: int = 0, named: object = None, length: int = 0, factor: int = 1) -> tuple[Any, ...]:
        place = ffi.NULL if named is None else ffi.cast("void *", id(named))
        return getattr(lib, f"WHEEL_PYTHON_{kind}"), length, factor, ffi.cast("void *", at), place

    match value:
        case Argument():
            yield row("ARGUMENT")
        case Object(named):
            yield row("OBJECT", named=named)
        case Number(address, c_type, factor):
            yield row(_NUMBERS[c_type], at=address, factor=factor)
        case Choice(address, objects):
            yield row("CHOICE", at=address, named=objects)
        case Kept(made):
            first = made.values[0]
            assert isinstance(first, Number)
            holder = [None]
            memory = ffi.new("wheel_python_kept *", {"holder": ffi.cast("void *", id(holder))})
            kept += (holder, memory)
            at, length = first.address, len(made.values) * ffi.sizeof(first.c_type)
            rows = list(_flat(made, kept))
            yield (*row("KEPT", at=at, length=length, factor=len(rows))[:-1], ffi.cast("void *", memory))
            yield from rows
        case Tuple(kind, values):
            yield row("TUPLE", named=kind, length=len(values))
            for one in values:
                yield from _flat(one, kept)
