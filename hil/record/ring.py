"""Ring of float rows in memory that two processes share: one process puts rows, the other takes them.

``head`` and ``tail`` count rows from the start and never wrap. Only the producer writes ``head``, only the consumer
writes ``tail``. Each is one aligned 64-bit word, so the other side sees the old or the new value, never a mixture.

All counts of the consumer are in the shared memory too, so another process can take its place when it dies. A row is
saved by moving the tail past it: one word, which a kill cannot leave half written.

Python has no memory barrier: a consumer on a processor with weak ordering must not read a row the moment ``head``
covers it. The recorder reads up to the ``head`` of its previous poll, which is milliseconds old.
"""

import mmap
import os
import sys
import tempfile
import uuid
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Row: TypeAlias = bytes
"""The values of a row as doubles, one after the other."""
Rows: TypeAlias = "npt.NDArray[np.float64]"

# Words of the header, 8 bytes each. What the two sides write lies in cache lines of its own.
_CAPACITY, _WIDTH, _HEAD, _DROPPED, _TAIL, _LOST, _LINES, _LINES_LOST, _FILE_NUMBER = 0, 1, 8, 9, 16, 17, 18, 19, 20
_TABLE = 24  # from here on, for each file: the rows and lines that were saved when it was begun
MOST_FILES = 16384
_SKIPPED = -1
_HEADER_BYTES = 8 * (_TABLE + 2 * MOST_FILES)


class SharedBlock:
    """A block of zeroed memory that a child process maps too; it is gone with the last process that maps it.

    It has no name in the file system, unlike one of ``multiprocessing.shared_memory``, which outlives a SIGKILL: on
    POSIX the child inherits a descriptor, on Windows the kernel counts the handles.

    ``buffer`` has the bytes, none before ``allocate``. ``token``, ``"fd:N"`` or ``"tag:NAME"``, is for ``attach``.
    ``pass_fds`` are descriptors that ``subprocess.Popen`` has to hand on (none on Windows).
    """

    def __init__(self, token: str, fd: int | None) -> None:
        self._mapping: mmap.mmap | None = None
        self._fd = fd
        self.buffer = memoryview(b"")
        self.token = token
        self.pass_fds = () if fd is None else (fd,)

    @classmethod
    def reserve(cls) -> "SharedBlock":
        """Make an empty block, whose ``token`` a child process can get before the size is known."""
        if sys.platform == "win32":
            return cls(f"tag:hil-{uuid.uuid4()}", None)
        if sys.platform == "linux":
            fd = os.memfd_create("hil-telemetry")  # never written back to a disk, unlike a temporary file
        else:
            fd, path = tempfile.mkstemp(prefix="hil-telemetry-")
            os.unlink(path)  # noqa: PTH108 -- the descriptor keeps the file until it is closed
        return cls(f"fd:{fd}", fd)

    def allocate(self, size: int) -> "SharedBlock":
        """Give the block ``size`` bytes, touch every page so that no later write takes a page fault, and return it."""
        if self._fd is not None:
            os.ftruncate(self._fd, size)
        self._map(size)
        self.buffer[:: mmap.PAGESIZE] = bytes(-(-size // mmap.PAGESIZE))
        return self

    @classmethod
    def attach(cls, token: str, size: int) -> "SharedBlock":
        """Map, in the child process, the block that ``token`` names; the run must have allocated it."""
        block = cls(token, None if sys.platform == "win32" else int(token.removeprefix("fd:")))
        block._map(size)
        return block

    def _map(self, size: int) -> None:
        if sys.platform == "win32":
            self._mapping = mmap.mmap(-1, size, tagname=self.token.partition(":")[2])
        else:
            assert self._fd is not None
            self._mapping = mmap.mmap(self._fd, size)
        self.buffer = memoryview(self._mapping)

    def close(self) -> None:
        """Unmap the block. Views of ``buffer`` must be released before; closing twice is allowed."""
        self.buffer.release()
        if self._mapping is not None:
            self._mapping.close()
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None


class Kept(NamedTuple):
    """How many rows, and lines of the event log, are in a file."""

    rows: int
    lines: int


def ring_bytes(capacity: int, width: int) -> int:
    """Return the size [byte] of a block that holds ``capacity`` rows of ``width`` floats."""
    return _HEADER_BYTES + capacity * width * 8


class _Counts:
    """The counts in the header, which both sides read."""

    _words: "memoryview[int]"

    @property
    def head(self) -> int:
        """Rows put so far, without the dropped ones; those from ``tail`` to here are in the ring."""
        return self._words[_HEAD]

    @property
    def tail(self) -> int:
        """Rows that the consumer has saved or given up."""
        return self._words[_TAIL]

    @property
    def dropped(self) -> int:
        """Rows that the producer dropped because the ring was full."""
        return self._words[_DROPPED]

    @property
    def saved(self) -> int:
        """Rows that are safe in a file."""
        return self._words[_TAIL] - self._words[_LOST]

    @property
    def lines_saved(self) -> int:
        """Lines of the event log that the consumer has written; they come through a pipe, not through the ring."""
        return self._words[_LINES]

    @property
    def lines_lost(self) -> int:
        """Those of ``lines_saved`` that were in a file that was removed."""
        return self._words[_LINES_LOST]

    @property
    def file_number(self) -> int:
        """Number of the file that was opened last, by this consumer or the one before it; 0 before the first."""
        return self._words[_FILE_NUMBER]

    def files(self) -> dict[int, Kept]:
        """Return how much is in each file, by the file's number; ``MOST_FILES`` also counts the files after it."""
        begun = {number: self._begun(number) for number in range(1, min(self.file_number, MOST_FILES) + 1)}
        numbers = [number for number, kept in begun.items() if kept.rows != _SKIPPED]
        ends = [*(begun[number] for number in numbers[1:]), Kept(self.saved, self.lines_saved - self.lines_lost)]
        return {
            number: Kept(end.rows - begun[number].rows, end.lines - begun[number].lines)
            for number, end in zip(numbers, ends, strict=False)
        }

    def _begun(self, number: int) -> Kept:
        """Return how much had been saved in all when file ``number`` was begun."""
        at = _TABLE + 2 * (number - 1)
        return Kept(self._words[at], self._words[at + 1])


class RingWriter(_Counts):
    """The producer's side. Raises ValueError for a capacity or width below one.

    ``try_put`` stores one row and returns True; when the ring is full, it stores nothing and returns
    ``when_full(row)``. It raises ValueError for a row of the wrong width.
    """

    def __init__(
        self, block: SharedBlock, capacity: int, width: int, when_full: Callable[[Row], bool] = lambda _row: False
    ) -> None:
        if capacity < 1 or width < 1:
            raise ValueError(f"ring of {capacity} rows of {width} floats: both must be at least 1")
        self._words = block.buffer[:_HEADER_BYTES].cast("q")
        self._rows = block.buffer[_HEADER_BYTES : ring_bytes(capacity, width)]
        self._words[_CAPACITY], self._words[_WIDTH] = capacity, width
        self.try_put = _putter(self._words, self._rows, capacity, width, when_full)
        self._capacity = capacity

    @property
    def full(self) -> bool:
        """Whether there is no room for another row."""
        return self.head - self.tail >= self._capacity

    def count_dropped(self) -> None:
        """Count one row that was dropped."""
        self._words[_DROPPED] += 1

    def close(self) -> None:
        """Release the views of the block, so that it can be closed."""
        self._words.release()
        self._rows.release()


def _putter(
    words: "memoryview[int]", rows: "memoryview[int]", capacity: int, width: int, when_full: Callable[[Row], bool]
) -> Callable[[Row], bool]:
    """Return ``RingWriter.try_put``: a closure, which needs no attribute look-ups; it is called in each tick."""
    row_bytes = width * 8
    head = tail_seen = 0

    def try_put(row: Row) -> bool:
        nonlocal head, tail_seen
        if head - tail_seen >= capacity:
            tail_seen = words[_TAIL]
            if head - tail_seen >= capacity:
                return when_full(row)
        begin = head % capacity * row_bytes
        rows[begin : begin + row_bytes] = row
        head += 1
        words[_HEAD] = head
        return True

    return try_put


class RingReader(_Counts):
    """The consumer's side. Raises ValueError when the block is smaller than its header says."""

    def __init__(self, block: SharedBlock) -> None:
        import numpy as np  # not above: a run starts its recorder before it imports NumPy

        self._words = block.buffer[:_HEADER_BYTES].cast("q")
        self.capacity, self.width = self._words[_CAPACITY], self._words[_WIDTH]
        if self.capacity < 1 or self.width < 1 or len(block.buffer) < ring_bytes(self.capacity, self.width):
            self._words.release()
            raise ValueError(f"ring of {self.capacity} rows of {self.width} floats does not fit its block")
        floats = np.frombuffer(block.buffer, np.float64, self.capacity * self.width, _HEADER_BYTES)
        self._rows = floats.reshape(self.capacity, self.width)
        self._order = np.arange(self.capacity)
        self._head_seen = self.tail

    def settled(self) -> int:
        """Return the number up to which rows are safe to read: the value of ``head`` at the previous call."""
        settled, self._head_seen = self._head_seen, self.head
        return settled

    def rows(self, start: int, stop: int) -> Rows:
        """Return a copy of the rows ``start`` to ``stop`` (exclusive), counted from the first ever put.

        Raises IndexError for rows that are not in the ring.
        """
        if not self.tail <= start <= stop <= self.head:
            raise IndexError(f"rows {start} to {stop} are not in the ring, which holds {self.tail} to {self.head}")
        return self._rows[(self._order[: stop - start] + start) % self.capacity]

    def release(self, stop: int) -> None:
        """Free the rows before ``stop``: they are safe in a file."""
        self._words[_TAIL] = stop

    def give_up(self, stop: int) -> None:
        """Free the rows before ``stop``, and count them as lost."""
        self._words[_LOST] += stop - self._words[_TAIL]
        self._words[_TAIL] = stop

    def add_lines_saved(self, count: int) -> None:
        """Count ``count`` more lines as safe in a file."""
        self._words[_LINES] += count

    def begin_file(self, number: int) -> None:
        """Record that file ``number`` was opened, and that the numbers skipped before it have no file of this run."""
        for skipped in range(self.file_number + 1, min(number, MOST_FILES + 1)):
            self._words[_TABLE + 2 * (skipped - 1)] = _SKIPPED
        if number <= MOST_FILES:
            at = _TABLE + 2 * (number - 1)
            self._words[at], self._words[at + 1] = self.saved, self.lines_saved - self.lines_lost
        self._words[_FILE_NUMBER] = number

    def lose_file(self) -> None:
        """Count the rows and lines in the newest file as lost."""
        kept = self.files()[min(self.file_number, MOST_FILES)]
        self._words[_LOST] += kept.rows
        self._words[_LINES_LOST] += kept.lines

    def close(self) -> None:
        """Release the views of the block, so that it can be closed."""
        self._words.release()
        del self._rows
