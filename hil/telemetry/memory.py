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
        buffer: the bytes, writable by both sides.
        token: ``"fd:N"`` or ``"tag:NAME"``; give it to ``attach`` in the child.
        pass_fds: descriptors that ``subprocess.Popen`` has to hand on (empty on Windows).
    """

    def __init__(self, mapping: mmap.mmap, token: str, fd: int | None) -> None:
        self._mapping = mapping
        self._fd = fd
        self.buffer = memoryview(mapping)
        self.token = token
        self.pass_fds = () if fd is None else (fd,)

    @classmethod
    def create(cls, size: int) -> "SharedBlock":
        """Make a block of ``size`` bytes and touch every page, so that no later write takes a page fault."""
        if sys.platform == "win32":
            tag = f"hil-{uuid.uuid4()}"
            block = cls(mmap.mmap(-1, size, tagname=tag), f"tag:{tag}", None)
        else:
            fd = _nameless_file()
            os.ftruncate(fd, size)
            block = cls(mmap.mmap(fd, size), f"fd:{fd}", fd)
        block.buffer[:] = bytes(size)
        return block

    @classmethod
    def attach(cls, token: str, size: int) -> "SharedBlock":
        """Map the block that ``token`` names, in the child process."""
        kind, _, where = token.partition(":")
        if sys.platform == "win32":
            return cls(mmap.mmap(-1, size, tagname=where), token, None)
        if kind != "fd":
            raise ValueError(f"shared block {token!r}: expected 'fd:N' on this system")
        return cls(mmap.mmap(int(where), size), token, int(where))

    def close(self) -> None:
        """Unmap the block. Views of ``buffer`` must be released before; closing twice is allowed."""
        self.buffer.release()
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
