"""A file that is written whole or not at all."""

from pathlib import Path

from hil.errors import BadInputError


def write_whole(path: Path, data: bytes, what: str = "file") -> None:
    """Write a file, in place of an older one; when that fails, on a full disk for one, nothing of it stays.

    Raises BadInputError, which names ``what`` it was to be.
    """
    try:
        path.write_bytes(data)
    except OSError as error:
        if path.is_file() and not path.is_symlink():
            path.unlink()
        raise BadInputError(
            f"{what} {path}: it cannot be written ({error.strerror}); name a folder that exists, has room and may be "
            "written to"
        ) from error
