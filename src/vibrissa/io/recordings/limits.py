"""How much memory a file may ask for: what it claims is held against its own size before anything
is allocated.
"""

from pathlib import Path

from vibrissa.files import InputError

_FREE = 64 * 2**20
_FACTOR = 100


class Budget:
    """Bytes that the contents of a file may come to: 64 MiB, or 100 times the file where that is
    more.

    Recorded noise hardly compresses, so that a recording stays far below; a few bytes that claim
    gigabytes do not.
    """

    def __init__(self, file: Path, size: int | None = None) -> None:
        self._file = file
        self._size = file.stat().st_size if size is None else size
        self._left = self.allowed = max(_FREE, _FACTOR * self._size)

    @property
    def left(self) -> int:
        """Bytes not yet taken."""
        return self._left

    def take(self, count: int, what: str) -> None:
        """Set bytes aside.

        Raises
        ------
        InputError
            If `what` comes to more than is left.
        """
        if not 0 <= count <= self._left:
            raise InputError(
                f"{self._file}: {what} comes to {count} bytes in a file of {self._size}; allowed are {self.allowed} bytes in all, "
                "64 MiB or 100 times the file"
            )
        self._left -= count
