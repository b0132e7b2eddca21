"""Files written at given offsets and created atomically; OS errors name the file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Make OS errors name the file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


class FileDisk:
    """A file written at given offsets, without buffering in this process.

    Parameters
    ----------
    path
        The file.
    name
        Name for OS errors, if the file is to be renamed later.
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
        """Cut the file off at this size."""
        self._file.truncate(size)

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._file.close()


@contextmanager
def whole_file(path: Path) -> Iterator[FileDisk]:
    """A file written under a temporary name and renamed when the block ends; if that fails, nothing
    is left of it.
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
