"""Reads named tuples from the memory of C structs, in a fifth of the time that it takes field by field.

``Tuple`` describes what is read: ``number``, ``numbers`` and ``Choice`` name places in memory by cffi pointers.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from firmware_protocol.fast_calls import address_of, fast_call
from firmware_protocol.host import library

_NUMBERS = {"float": "FLOAT", "double": "DOUBLE", "uint8_t": "UINT8", "uint16_t": "UINT16", "uint64_t": "UINT64"}


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
    values: "tuple[Number | Choice | Tuple, ...]"


def fields_of(ffi: Any, struct: Any, name: str, first: int = 0, count: int | None = None) -> tuple[Number, ...]:
    """Return the numbers of a field of the struct that a cffi pointer is of; of an array all, or ``count`` of them."""
    kind = ffi.typeof(struct).item.fields
    field = dict(kind)[name]
    array = field.type.kind == "array"
    item = field.type.item if array else field.type
    begin, size = address_of(struct) + field.offset, ffi.sizeof(item)
    length = (field.type.length if array else 1) - first if count is None else count
    return tuple(Number(begin + place * size, item.cname) for place in range(first, first + length))


def tuple_reader(what: Tuple, memory: object, given: Number | None = None) -> Callable[[], Any]:
    """Return a function that returns the tuple as it is in memory now; None while the bool ``given`` is false.

    It keeps ``memory`` alive, the owner of the numbers. Raises BuildError when the library cannot be loaded.
    """
    ffi, _ = library()
    values = ffi.new("wheel_python_value[]", list(_flat(what)))
    if given is not None:
        values[0].at = ffi.cast("void *", given.address)
    return fast_call("read", values, (what, memory))


def _flat(value: Number | Choice | Tuple) -> Iterator[tuple[Any, ...]]:
    ffi, lib = library()

    def pointer(address: int) -> Any:
        return ffi.cast("void *", address)

    if isinstance(value, Number):
        kind = getattr(lib, f"WHEEL_PYTHON_{_NUMBERS[value.c_type]}")
        yield kind, 0, value.factor, pointer(value.address), ffi.NULL
    elif isinstance(value, Choice):
        yield lib.WHEEL_PYTHON_CHOICE, 0, 1, pointer(value.address), pointer(id(value.objects))
    else:
        kind = ffi.NULL if value.kind is None else pointer(id(value.kind))
        yield lib.WHEEL_PYTHON_TUPLE, len(value.values), 1, ffi.NULL, kind
        for one in value.values:
            yield from _flat(one)
