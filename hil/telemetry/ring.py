"""Ring of float rows between one producer and one consumer, in memory that two processes share.

``head`` and ``tail`` count rows from the start and never wrap; only the producer writes ``head``, only the
consumer writes ``tail``. Each is stored as one aligned 64-bit word, so that the other side sees the old or
the new value. What the consumer counts lies there too, so that another can take the place of one that died.
Python has no memory barrier: a consumer on a processor with weak ordering must not read a row the moment
``head`` covers it. The recorder reads up to the ``head`` of its previous poll, milliseconds old.
"""

import struct
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hil.telemetry.memory import SharedBlock

Row = tuple[float, ...]
Rows = npt.NDArray[np.float64]

# Words of the header, 8 bytes each. What the two sides write lies in cache lines of its own.
_CAPACITY, _WIDTH, _HEAD, _DROPPED, _TAIL, _SAVED, _LINES, _PART = 0, 1, 8, 9, 16, 17, 18, 19
_HEADER_BYTES = 192


def ring_bytes(capacity: int, width: int) -> int:
    """Return the size [byte] of a block that holds ``capacity`` rows of ``width`` floats."""
    return _HEADER_BYTES + capacity * width * 8


class RingWriter:
    """The producer's side.

    Raises ValueError for a capacity or width below one.

    Attributes:
        try_put: stores one row; when the ring is full, it stores and counts nothing and returns what ``when_full``
            makes of the row. Raises struct.error when the row has another width or holds what is no number.
    """

    def __init__(
        self, block: SharedBlock, capacity: int, width: int, when_full: Callable[[Row], bool] = lambda _row: False
    ) -> None:
        if capacity < 1 or width < 1:
            raise ValueError(f"ring of {capacity} rows of {width} floats: both must be at least 1")
        self._words = block.buffer[:_HEADER_BYTES].cast("q")
        self._rows = block.buffer[_HEADER_BYTES : ring_bytes(capacity, width)]
        self._words[_CAPACITY] = capacity
        self._words[_WIDTH] = width
        self.try_put = _putter(self._words, self._rows, capacity, width, when_full)
        self._capacity = capacity

    @property
    def head(self) -> int:
        """Rows put so far, without the dropped ones."""
        return self._words[_HEAD]

    @property
    def tail(self) -> int:
        """Rows that the consumer is done with."""
        return self._words[_TAIL]

    @property
    def saved(self) -> int:
        """Rows that the consumer said are safe."""
        return self._words[_SAVED]

    @property
    def lines_saved(self) -> int:
        """Lines beside the ring that the consumer said are safe."""
        return self._words[_LINES]

    @property
    def part(self) -> int:
        """Number of the file that the consumer opened last, from 1."""
        return self._words[_PART]

    @property
    def dropped(self) -> int:
        """Rows dropped because the ring was full."""
        return self._words[_DROPPED]

    @property
    def full(self) -> bool:
        """Whether there is no room for another row."""
        return self.head - self.tail >= self._capacity

    def count_dropped(self) -> None:
        """Count one row that was given up."""
        self._words[_DROPPED] += 1

    def close(self) -> None:
        """Release the views of the block, so that it can be closed."""
        self._words.release()
        self._rows.release()


def _putter(
    words: "memoryview[int]",
    rows: "memoryview[int]",
    capacity: int,
    width: int,
    when_full: Callable[[Row], bool],
) -> Callable[[Row], bool]:
    """Return ``RingWriter.try_put``. It is called in each tick: a closure looks nothing up in an object."""
    pack_into = struct.Struct(f"{width}d").pack_into
    row_bytes = width * 8
    head = tail_seen = 0

    def try_put(row: Row) -> bool:
        nonlocal head, tail_seen
        if head - tail_seen >= capacity:
            tail_seen = words[_TAIL]
            if head - tail_seen >= capacity:
                return when_full(row)
        pack_into(rows, head % capacity * row_bytes, *row)
        head += 1
        words[_HEAD] = head
        return True

    return try_put


class RingReader:
    """The consumer's side. Raises ValueError when the block is smaller than its header says."""

    def __init__(self, block: SharedBlock) -> None:
        self._words = block.buffer[:_HEADER_BYTES].cast("q")
        self.capacity = self._words[_CAPACITY]
        self.width = self._words[_WIDTH]
        if self.capacity < 1 or self.width < 1 or len(block.buffer) < ring_bytes(self.capacity, self.width):
            self._words.release()
            raise ValueError(f"ring of {self.capacity} rows of {self.width} floats does not fit its block")
        self._rows = np.frombuffer(
            block.buffer, dtype=np.float64, count=self.capacity * self.width, offset=_HEADER_BYTES
        ).reshape(self.capacity, self.width)
        self._head_seen = self.tail

    @property
    def head(self) -> int:
        """Rows put so far; those from ``tail`` to here are in the ring."""
        return self._words[_HEAD]

    @property
    def tail(self) -> int:
        """Rows released so far."""
        return self._words[_TAIL]

    @property
    def dropped(self) -> int:
        """Rows that the producer dropped so far."""
        return self._words[_DROPPED]

    def settled(self) -> int:
        """Return how far rows may be read: to where the head was at the last call. Younger ones may not be settled."""
        settled, self._head_seen = self._head_seen, self.head
        return settled

    def rows(self, start: int, stop: int) -> Rows:
        """Return a copy of the rows ``start`` to ``stop`` (exclusive), counted from the first ever put.

        Raises IndexError for rows that are not in the ring.
        """
        if not self.tail <= start <= stop <= self.head:
            raise IndexError(f"rows {start} to {stop} are not in the ring, which holds {self.tail} to {self.head}")
        return self._rows[np.arange(start, stop) % self.capacity]

    def release(self, stop: int) -> None:
        """Give the rows before ``stop`` back to the producer."""
        self._words[_TAIL] = stop

    @property
    def saved(self) -> int:
        """Rows that are safe."""
        return self._words[_SAVED]

    def add_saved(self, count: int) -> None:
        """Tell the producer that so many more rows are safe, whatever happens to this process; less when negative."""
        self._words[_SAVED] += count

    def add_lines_saved(self, count: int) -> None:
        """Tell the producer that so many more lines are safe."""
        self._words[_LINES] += count

    @property
    def part(self) -> int:
        """Number of the file that was opened last, by this process or the one before it; 0 before the first."""
        return self._words[_PART]

    def set_part(self, number: int) -> None:
        """Note which file was opened."""
        self._words[_PART] = number

    def close(self) -> None:
        """Release the views of the block, so that it can be closed."""
        self._words.release()
        del self._rows
