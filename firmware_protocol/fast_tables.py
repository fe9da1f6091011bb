"""Looks up numbers in tables in the host library, in a tenth of the time that it takes in Python."""

from collections.abc import Callable, Sequence
from typing import Any

from firmware_protocol.fast_calls import fast_call
from firmware_protocol.fast_tuples import Tuple, numbers_at, tuple_constructor
from firmware_protocol.host import library

Table = tuple[tuple[float, float], Sequence[tuple[float, ...]]]
"""Cells in a unit of either input, and 16 cells, row by row (second input). A cell is eight numbers: a, b, c and d of
both results, each a + b p + q (c + d p) with p and q, the places of the inputs, from 0 to 4."""


class Tables:
    """Some tables of 4 by 4 cells; zero is in the middle, and beyond its ends a table holds.

    Raises BuildError when the library cannot be loaded.

    Attributes:
        look_up: takes a tuple of the first input of each table, then of the second; returns one of the first results,
            then of the second. NaN counts as the beginning of a table.
        nearest: returns four numbers a table for the newest look-up: both places, from -2 to 2; the nearest corner, 5
            times its row plus its column; and the product of its shares in both, 0.25 to 1. NaN before it.
    """

    def __init__(self, tables: Sequence[Table]) -> None:
        ffi, _ = library()
        made = ffi.new("wheel_python_table[]", [(scales, [(c[:4], c[4:]) for c in cells]) for scales, cells in tables])
        nearest = ffi.new("double[]", [float("nan")] * (4 * len(tables)))
        owner = ffi.new("wheel_python_tables *", (made, len(tables), nearest))
        self.look_up: Callable[..., Any] = fast_call("look_up", owner, (made, nearest))
        self.nearest: Callable[[], tuple[float, ...]] = tuple_constructor(
            Tuple(None, numbers_at(ffi, nearest)), nearest
        )
