"""Memory that two processes share and that nobody can leave behind.

The block has no name in the file system: on POSIX the child inherits a descriptor, on Windows the kernel
counts the handles. It is gone with the last process that maps it, however that process ends. (A block of
``multiprocessing.shared_memory`` has a name, outlives a SIGKILL, and is unlinked by the resource tracker of
whichever process ends first.)
"""

import mmap
import os
import sys
import tempfile
import uuid


class SharedBlock:
    """A block of zeroed memory; ``token`` tells the child process where to find it.

    Attributes:
        buffer: the bytes, writable by both sides; none before they are allocated.
        token: ``"fd:N"`` or ``"tag:NAME"``; give it to ``attach`` in the child.
        pass_fds: descriptors that ``subprocess.Popen`` has to hand on (empty on Windows).
    """

    def __init__(self, token: str, fd: int | None) -> None:
        self._mapping: mmap.mmap | None = None
        self._fd = fd
        self.buffer = memoryview(b"")
        self.token = token
        self.pass_fds = () if fd is None else (fd,)

    @classmethod
    def create(cls, size: int) -> "SharedBlock":
        """Make a block of ``size`` bytes."""
        block = cls.reserve()
        block.allocate(size)
        return block

    @classmethod
    def reserve(cls) -> "SharedBlock":
        """Make a block without bytes, which a child process can be told of before its size is known."""
        if sys.platform == "win32":
            return cls(f"tag:hil-{uuid.uuid4()}", None)
        fd = _nameless_file()
        return cls(f"fd:{fd}", fd)

    def allocate(self, size: int) -> None:
        """Give the block ``size`` bytes and touch every page, so that no later write takes a page fault."""
        if self._fd is not None:
            os.ftruncate(self._fd, size)
        self._map(size)
        self.buffer[:] = bytes(size)

    @classmethod
    def attach(cls, token: str, size: int) -> "SharedBlock":
        """Map the block that ``token`` names, in the child process, when the run has allocated it."""
        kind, _, where = token.partition(":")
        if sys.platform == "win32":
            block = cls(token, None)
        elif kind == "fd":
            block = cls(token, int(where))
        else:
            raise ValueError(f"shared block {token!r}: expected 'fd:N' on this system")
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


def _nameless_file() -> int:
    if sys.platform == "linux":
        # Never written back to a disk, unlike a temporary file.
        return os.memfd_create("hil-telemetry")
    fd, path = tempfile.mkstemp(prefix="hil-telemetry-")
    os.unlink(path)  # noqa: PTH108 -- the descriptor keeps the file until it is closed
    return fd
