"""Files that are written at places, put there whole; errors of the system name the file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Errors of the system name the file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


class FileDisk:
    """A file that is written at places, at once: nothing is kept in this process.

    Parameters
    ----------
    path
        Of the file.
    name
        What errors of the system name, where the file is still to get its name.
    """

    def __init__(self, path: Path, name: Path | None = None) -> None:
        self._name = name or path
        with naming_file(self._name):
            self._file = path.open("w+b", buffering=0)

    def write(self, data: bytes, place: int) -> None:
        """Write all of it."""
        left = memoryview(data)
        with naming_file(self._name):
            while left:
                done = os.pwrite(self._file.fileno(), left, place)
                left, place = left[done:], place + done

    def truncate(self, size: int) -> None:
        """Cut off what lies beyond."""
        self._file.truncate(size)

    def close(self) -> None:
        """Close it; may be called twice."""
        self._file.close()


@contextmanager
def whole_file(path: Path) -> Iterator[FileDisk]:
    """A file that is made beside its place, and put there once the block has ended; where that
    fails, nothing is left of it.
    """
    part = path.with_name(f".{path.name}.part")
    disk = FileDisk(part, path)
    try:
        yield disk
        with naming_file(path):
            part.replace(path)
    except BaseException:
        disk.close()
        part.unlink(missing_ok=True)
        raise
