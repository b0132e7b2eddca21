"""What the footer of a Parquet file claims of its columns, read before the library is asked.

The footer is a struct of Thrift's compact protocol (Apache Parquet, `parquet.thrift`; Apache
Thrift, *Compact protocol encoding*). pyarrow gives the same numbers, but where a footer is damaged
its C++ code may end the whole process at that question (an exception that nothing catches).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from struct import unpack

_TRUE = 1
_DEEPEST = 16
_LONGEST_NUMBER = 10
_ROW_GROUPS, _COLUMNS, _META_DATA, _PATH, _VALUES, _BYTES = 4, 1, 3, 3, 5, 6


@dataclass(frozen=True)
class Chunk:
    """One column of one row group.

    Attributes
    ----------
    path
        Names from the outermost column to the innermost part.
    values
        Count of the numbers in it, nulls included.
    size
        Bytes, unpacked.
    """

    path: tuple[str, ...]
    values: int
    size: int


def chunks(file: Path) -> Iterator[Chunk]:
    """Every column of every row group.

    Raises
    ------
    ValueError
        If the file has no footer, or the footer is none.
    """
    with file.open("rb") as opened:
        length = opened.seek(0, 2)
        opened.seek(max(0, length - 8))
        size, sign = unpack("<I4s", opened.read(8).rjust(8, b"\0"))
        if sign != b"PAR1" or size > length - 12:
            raise ValueError(f"no footer in {length} bytes")
        opened.seek(length - 8 - size)
        footer = _Reader(opened.read(size))
    for group in _listed(footer.struct(), _ROW_GROUPS):
        for column in _listed(group, _COLUMNS):
            found = _fields(column).get(_META_DATA)
            if not isinstance(found, dict):
                raise ValueError("a column without its figures")
            path, values, total = found.get(_PATH), found.get(_VALUES), found.get(_BYTES)
            if (
                not isinstance(path, list)
                or not isinstance(values, int)
                or not isinstance(total, int)
            ):
                raise ValueError("a column without its name, count or size")
            yield Chunk(
                tuple(str(part, "utf-8", "replace") for part in path if isinstance(part, bytes)),
                values,
                total,
            )


def _fields(value: object) -> dict[int, object]:
    if not isinstance(value, dict):
        raise ValueError("a struct is missing")
    return value


def _listed(value: object, field: int) -> list[object]:
    found = _fields(value).get(field)
    if not isinstance(found, list):
        raise ValueError(f"the list of field {field} is missing")
    return found


class _Reader:
    """Values of the compact protocol, one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def struct(self, depth: int = 0) -> dict[int, object]:
        """Fields by their numbers."""
        found: dict[int, object] = {}
        number = 0
        while head := self._byte():
            kind, step = head & 15, head >> 4
            number = number + step if step else self._signed()
            found[number] = self._value(kind, depth, inside=False)
        return found

    def _value(self, kind: int, depth: int, *, inside: bool) -> object:
        if depth > _DEEPEST:
            raise ValueError("nested too deeply")
        match kind:
            case 1 | 2:
                return self._byte() if inside else int(kind == _TRUE)
            case 3:
                return self._byte()
            case 4 | 5 | 6:
                return self._signed()
            case 7:
                return self._bytes(8)
            case 8:
                return self._bytes(self._number())
            case 9 | 10:
                head = self._byte()
                count = head >> 4 if head >> 4 < 15 else self._number()
                # An item takes a byte at least, so that a count is never larger than what is left.
                if count > len(self._content) - self._at:
                    raise ValueError(f"a list of {count} items")
                return [self._value(head & 15, depth + 1, inside=True) for _ in range(count)]
            case 12:
                return self.struct(depth + 1)
            case _:
                raise ValueError(f"a value of type {kind}")

    def _byte(self) -> int:
        return self._bytes(1)[0]

    def _bytes(self, count: int) -> bytes:
        found = self._content[self._at : self._at + count]
        if len(found) < count:
            raise ValueError("it ends within a value")
        self._at += count
        return found

    def _number(self) -> int:
        """Seven bits a byte, the lowest first."""
        total = 0
        for place in range(_LONGEST_NUMBER):
            byte = self._byte()
            total |= (byte & 127) << 7 * place
            if byte < 128:
                return total
        raise ValueError("a number of too many bytes")

    def _signed(self) -> int:
        number = self._number()
        return (number >> 1) ^ -(number & 1)
