"""What every reader of files needs: errors in one line, and tables of numbers."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

_LONGEST = 1600  # letters of a message: half a screen
LARGEST = 1e12
"""Numbers beyond this are damage: no unit in use makes a force or a length that large."""


class InputError(ValueError):
    """A file, or an argument that names one, that cannot be used: the message names file, field,
    value and what is allowed.
    """

    def __init__(self, message: str) -> None:
        line = " ".join(message.splitlines())
        super().__init__(
            line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} … {line[-_LONGEST // 2 :]}"
        )


def readable(path: Path) -> Path:
    """Return the path; raise InputError unless it is a file that can be opened."""
    try:
        with path.open("rb"):
            return path
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{path}: cannot be read ({reason}); allowed is a readable file"
        ) from error


def read_table(
    file: Path,
    columns: Sequence[str],
    *,
    optional: Sequence[str] = (),
    any_order: bool = False,
    finite: bool = True,
) -> dict[str, np.ndarray]:
    """Numbers (rows,) by column from a CSV file whose first line names the columns.

    Parameters
    ----------
    file
        UTF-8 text, cells separated by commas.
    columns
        Names that must be there.
    optional
        Names that may be there besides.
    any_order
        Whether the columns may come in another order than that of `columns`.
    finite
        Whether numbers have to be finite and at most 1e12.

    Raises
    ------
    InputError
        If the file cannot be read, columns are missing, unknown or twice, there is no row, a row is
        short or cut off, or a cell is not a number that is allowed.
    """
    text = text_of(readable(file))
    first, *lines = text.rstrip("\r\n ").splitlines() or [""]
    if not first:
        raise InputError(f"{file}: empty; allowed is CSV with the columns {','.join(columns)}")
    names = _header(file, first, columns, optional, any_order=any_order)
    if not lines:
        raise InputError(f"{file}: no rows; allowed is at least one sample")
    check_last_line(file, text, [first, *lines], names)
    numbers = []
    for number, line in enumerate(lines, start=2):
        cells = line.split(",")
        if len(cells) != len(names):
            raise InputError(
                f"{file}, line {number}: {len(cells)} of {len(names)} columns, the line is "
                f"truncated or damaged; allowed are {len(names)} numbers a line"
            )
        for name, cell in zip(names, cells, strict=True):
            try:
                numbers.append(float(cell.replace("_", "?")))
            except ValueError:
                raise InputError(
                    f"{file}, line {number}: {name} = {cell.strip()[:40]!r}; allowed is a number"
                ) from None
    table = np.array(numbers).reshape(-1, len(names))
    bad = np.argwhere(~(np.abs(table) <= LARGEST)) if finite else np.empty((0, 2))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"{file}, line {row + 2}: {names[column]} = {table[row, column]:g} "
            f"({len({*bad[:, 0]})} of {len(table)} rows hold such); "
            f"allowed are finite numbers up to {LARGEST:g}"
        )
    return dict(zip(names, table.T, strict=True))


def check_increasing(file: Path, time: Float[np.ndarray, "rows"]) -> None:
    """Raise InputError unless each time is after the one above it."""
    falling = np.flatnonzero(np.diff(time) <= 0)
    if falling.size:
        row = falling[0]
        raise InputError(
            f"{file}, line {row + 3}: time = {time[row + 1]} after {time[row]} "
            f"({len(falling)} such); allowed are increasing times"
        )


def text_of(file: Path) -> str:
    """Content of a text file in UTF-8; raise InputError if it is not."""
    try:
        return file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{file}: not a text file ({error.reason} at byte {error.start}); "
            "allowed is CSV in UTF-8"
        ) from error


def _header(
    file: Path, line: str, columns: Sequence[str], optional: Sequence[str], *, any_order: bool
) -> list[str]:
    names = [name.strip() for name in line.split(",")]
    own = [name for name in names if name not in optional]
    count = Counter(names)
    wrong = {
        "missing": [name for name in columns if name not in count],
        "unknown": sorted({*own} - {*columns}, key=own.index),
        "twice": [name for name in (*columns, *optional) if count[name] > 1],
    }
    findings = [f"{word} {', '.join(found)}" for word, found in wrong.items() if found]
    if not findings and not any_order and own != list(columns):
        findings = ["another order"]
    if findings:
        more = f", and optionally {','.join(optional)}" if optional else ""
        raise InputError(
            f"{file}, line 1: columns: {', '.join(findings)[:200]}; "
            f"allowed are {','.join(columns)}{more}"
        )
    return names


def check_last_line(
    file: Path,
    text: str,
    lines: Sequence[str],
    names: Sequence[str],
    *,
    delimiter: str = ",",
    first: int = 1,
) -> None:
    """A last line without its end may have lost digits: then its last number is shorter than the
    one above it.

    Raises
    ------
    InputError
        If it is; `first` is the number of the first of the lines in the text.
    """
    if text.endswith(("\n", "\r")) or len(lines) < 3:
        return
    above, last = (line.split(delimiter) for line in lines[-2:])
    digits = [len(cells[-1].strip().lstrip("-")) for cells in (above, last)]
    if len(last) == len(names) and digits[1] < digits[0]:
        raise InputError(
            f"{file}, line {first + len(lines) - 1}: {names[-1]} = {last[-1].strip()!r}, the last "
            "line is truncated: no line end, and fewer digits than above; "
            "allowed are complete lines"
        )
