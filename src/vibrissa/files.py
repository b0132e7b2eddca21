"""File input and output: one-line errors, and text tables."""

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import pandas

_LONGEST = 1600  # characters in a message: half a screen
LARGEST = 1e12
"""Larger numbers are corrupt data: no unit in use makes a force or a length that large."""


class InputError(ValueError):
    """An unusable file, or an argument that names one; the message gives file, field, value and
    what is allowed.
    """

    def __init__(self, message: str) -> None:
        line = " ".join(message.splitlines())
        super().__init__(
            line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} … {line[-_LONGEST // 2 :]}"
        )


@contextmanager
def reading(file: Path, what: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into a one-line `InputError` that names the
    file; a missing library is still an `ImportError`.
    """
    try:
        yield
    except (InputError, ImportError):
        raise
    except Exception as error:
        raise InputError(
            f"{file}: damaged {what} ({str(error)[:200]}); allowed is a whole file of {what}"
        ) from error


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


def writable(path: Path) -> Path:
    """Return the path of a file to write, creating its folder if needed; raise InputError if that
    is not possible.
    """
    writable_folder(path.parent)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed is a file")
    return path


def writable_folder(path: Path) -> Path:
    """Return the path of a folder to write to, creating it if needed; raise InputError if that is
    not possible.
    """
    wrong = "cannot be made"
    try:
        path.mkdir(parents=True, exist_ok=True)
        wrong = "is not writable"
        probe = path / ".vibrissa-write-test"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(
            f"{path}: the output folder {wrong} ({error.strerror or error}); "
            "allowed is a folder that can be written to"
        ) from error
    return path


def text_of(file: Path, encoding: str = "utf-8-sig") -> str:
    """Content of a text file; raise InputError if it cannot be read or decoded."""
    try:
        return readable(file).read_text(encoding=encoding)
    except UnicodeError as error:
        name = encoding.removesuffix("-sig").upper()
        raise InputError(f"{file}: not a text file ({error}); allowed is CSV in {name}") from error


def split(line: str, delimiter: str) -> list[str]:
    """Cells of one line, quoted or not; several spaces count as one separator."""
    return next(csv.reader([line.strip(" ")], delimiter=delimiter, skipinitialspace=True), [""])


def check_header(
    file: Path,
    names: Sequence[str],
    columns: Sequence[str],
    optional: Sequence[str] = (),
    *,
    line: int = 1,
    any_order: bool = False,
    hint: str = "",
) -> None:
    """Raise InputError unless `names` are the expected columns, each once and in this order; the
    message gives their line and ends with the hint.
    """
    own = [name for name in names if name not in optional]
    count = Counter(names)
    wrong = {
        "missing": [name for name in columns if name not in count],
        "unknown": [name for name in dict.fromkeys(own) if name not in columns],
        "twice": [name for name in (*columns, *optional) if count[name] > 1],
    }
    findings = [f"{word} {', '.join(found)}" for word, found in wrong.items() if found]
    if not findings and not any_order and own != list(columns):
        findings = ["another order"]
    if findings:
        more = f", and optionally {','.join(optional)}" if optional else ""
        raise InputError(
            f"{file}, line {line}: columns: {', '.join(findings)[:200]}; "
            f"allowed are {','.join(columns)}{more}{hint}"
        )


def cells_of(
    file: Path,
    text: str,
    names: Sequence[str],
    *,
    delimiter: str = ",",
    decimal: str = ".",
    skip: int = 1,
    comments: tuple[str, ...] | None = None,
) -> "pandas.DataFrame":
    """Cells of a text, read by pandas: a column is numeric if all its cells are, else text. Columns
    are numbered from 0; the index of a row is its line number, from 1.

    Parameters
    ----------
    file, text
        The file's name for messages, and its content.
    names
        Column names.
    delimiter, decimal
        Cell separator and decimal sign. Trailing delimiters and empty rows at the end are ignored.
    skip
        Lines before the first row.
    comments
        Prefixes of comment lines, which are skipped like blank lines; None if every line must be a
        row.

    Raises
    ------
    InputError
        If there are no rows, a line has the wrong number of cells, or the last line is cut off: it
        has no line end, and fewer digits in its last cell than the line above.
    """
    import pandas as pd  # noqa: PLC0415

    lines, count = text.splitlines(), len(names)
    rows: dict[int, str] = {}
    stop = len(lines)
    while stop > skip and not lines[stop - 1].strip(f'{delimiter}" \t'):
        stop -= 1
    for number, whole in enumerate(lines[skip:stop], skip + 1):
        line = whole.rstrip(" ")
        if comments is not None and (not line.strip() or line.lstrip().startswith(comments)):
            continue
        quoted = '"' in line or delimiter == " "
        cells = len(split(line, delimiter)) if quoted else line.count(delimiter) + 1
        while cells > count and line.endswith(delimiter):
            line, cells = line.removesuffix(delimiter).rstrip(" "), cells - 1
        if cells != count:
            raise InputError(
                f"{file}, line {number}: {cells} of {count} columns, the line is truncated or "
                f"damaged; allowed are {count} numbers a line"
            )
        rows[number] = line
    if not rows:
        raise InputError(f"{file}: no rows; allowed is at least one sample")
    last, above = [*reversed(rows.values()), ""][:2]
    ends = [line.rpartition(delimiter)[2].strip().lstrip("-") for line in (last, above)]
    if not text.endswith(("\n", "\r")) and stop in rows and len(ends[0]) < len(ends[1]):
        raise InputError(
            f"{file}, line {stop}: {names[-1]} = {ends[0]!r}, the last line is truncated: no line "
            "end, and fewer digits than above; allowed are complete lines"
        )
    frame = pd.read_csv(
        StringIO("\n".join(rows.values())),
        sep=r"\s+" if delimiter == " " else delimiter,
        decimal=decimal,
        header=None,
        na_filter=False,
        skipinitialspace=True,
        skip_blank_lines=False,
        low_memory=False,
    )
    if len(frame) != len(rows):
        raise ValueError("a quote is not closed")
    return frame.set_axis(list(rows))


def numbers_of(
    file: Path,
    name: str,
    cells: "pandas.Series[Any]",
    *,
    missing: Sequence[str] = (),
    decimal: str = ".",
    dates: bool = False,
    hint: str = "",
) -> Float[np.ndarray, "rows"]:
    """A column's cells as floats; for ISO 8601 dates, the seconds since 1970.

    Parameters
    ----------
    file, name
        For messages.
    cells
        Numbers or texts, indexed by line.
    missing
        Lower-case words for missing numbers, which become NaN.
    decimal
        Decimal sign.
    dates
        Whether the cells are dates.
    hint
        Added to the message if the cell contains a comma.

    Raises
    ------
    InputError
        If a cell is not a number.
    """
    import pandas as pd  # noqa: PLC0415

    if cells.dtype.kind in "iuf" and not dates:
        return cells.to_numpy(np.float64)
    texts = cells.astype(str).str.strip()
    if dates:
        moments = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
        numbers = (moments - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    else:
        points = texts if decimal == "." else texts.replace({r"\.": "?", ",": "."}, regex=True)
        numbers = pd.to_numeric(points, errors="coerce").astype(float)
    lost = texts[numbers.isna()]
    bad = lost[~lost.str.lower().isin(("nan", "-nan", *missing))]
    if len(bad):
        allowed = "a date of ISO 8601" if dates else "a number"
        raise InputError(
            f"{file}, line {bad.index[0]}: {name} = {bad.iloc[0][:40]!r}; allowed is {allowed}"
            + hint * ("," in bad.iloc[0])
        )
    return numbers.to_numpy(np.float64)


def read_table(
    file: Path,
    columns: Sequence[str],
    *,
    optional: Sequence[str] = (),
) -> dict[str, np.ndarray]:
    """Read the columns (rows,) of a CSV file whose first line names them.

    Parameters
    ----------
    file
        UTF-8 text, cells separated by commas.
    columns
        Required names, in any order.
    optional
        Names that may also be present.

    Raises
    ------
    InputError
        If the file cannot be read, columns are missing, unknown or repeated, there are no rows, a
        row is short or cut off, or a cell is not a finite number of magnitude at most 1e12.
    """
    text = text_of(file)
    first = text.partition("\n")[0].strip()
    if not first:
        raise InputError(f"{file}: empty; allowed is CSV with the columns {','.join(columns)}")
    names = [name.strip() for name in first.split(",")]
    check_header(file, names, columns, optional, any_order=True)
    with reading(file, "text"):
        cells = cells_of(file, text, names)
    table = {name: numbers_of(file, name, cells[place]) for place, name in enumerate(names)}
    for name, numbers in table.items():
        bad = np.flatnonzero(~(np.abs(numbers) <= LARGEST))
        if len(bad):
            raise InputError(
                f"{file}, line {cells.index[bad[0]]}: {name} = {numbers[bad[0]]:g} "
                f"({len(bad)} of {len(cells)} rows are out of range); "
                f"allowed are finite numbers up to {LARGEST:g}"
            )
    return table


def check_increasing(file: Path, time: Float[np.ndarray, "rows"]) -> None:
    """Raise InputError unless each time is later than the one above it."""
    falling = np.flatnonzero(np.diff(time) <= 0)
    if falling.size:
        row = falling[0]
        raise InputError(
            f"{file}, line {row + 3}: time = {time[row + 1]} after {time[row]} "
            f"({len(falling)} such); allowed are increasing times"
        )
