"""Files in and out: errors in one line, and tables of text."""

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


@contextmanager
def reading(file: Path, what: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into an `InputError` of one line that names
    the file; a missing library stays an `ImportError`.
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
    """Return the path of a file to be written, its folder made if need be; raise InputError where
    that cannot be.
    """
    writable_folder(path.parent)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed is a file")
    return path


def writable_folder(path: Path) -> Path:
    """Return the path of a folder to write into, made if need be; raise InputError where that
    cannot be.
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
    """Content of a text file; raise InputError if it cannot be read or has another encoding."""
    try:
        return readable(file).read_text(encoding=encoding)
    except UnicodeError as error:
        name = encoding.removesuffix("-sig").upper()
        raise InputError(f"{file}: not a text file ({error}); allowed is CSV in {name}") from error


def split(line: str, delimiter: str) -> list[str]:
    """Cells of one line, quoted or not; several spaces part as one does."""
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
    """Raise InputError unless these are the names of the columns, each once and in this order; the
    message names their line and ends with the hint.
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
    """Cells of a text, by pandas: numbers where all of a column are, else texts. Columns are counted
    from 0, rows named by their lines, from 1.

    Parameters
    ----------
    file, text
        For messages, and its content.
    names
        Of the columns.
    delimiter, decimal
        What separates cells, and the decimal sign. Delimiters behind the last cell and empty rows
        at the end are ignored.
    skip
        Lines before the first row.
    comments
        What comments begin with, which are skipped as blank lines are; None where every line has to
        be a row.

    Raises
    ------
    InputError
        If there is no row, a line holds another number of cells, or the last one is cut off: it has
        no line end, and fewer digits in its last cell than the line above.
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
    """Floats of the cells of a column; of dates of ISO 8601 the seconds since 1970.

    Parameters
    ----------
    file, name
        For messages.
    cells
        Numbers or texts by line.
    missing
        Words in small letters for numbers that are missing, which become NaN.
    decimal
        Decimal sign.
    dates
        Whether they are dates.
    hint
        What is said where a number holds a comma.

    Raises
    ------
    InputError
        If a cell is no number.
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
    """Numbers (rows,) by column from a CSV file whose first line names the columns.

    Parameters
    ----------
    file
        UTF-8 text, cells separated by commas.
    columns
        Names that must be there, in any order.
    optional
        Names that may be there besides.

    Raises
    ------
    InputError
        If the file cannot be read, columns are missing, unknown or twice, there is no row, a row is
        short or cut off, or a cell is not a finite number of at most 1e12.
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
                f"({len(bad)} of {len(cells)} rows hold such); "
                f"allowed are finite numbers up to {LARGEST:g}"
            )
    return table


def check_increasing(file: Path, time: Float[np.ndarray, "rows"]) -> None:
    """Raise InputError unless each time is after the one above it."""
    falling = np.flatnonzero(np.diff(time) <= 0)
    if falling.size:
        row = falling[0]
        raise InputError(
            f"{file}, line {row + 3}: time = {time[row + 1]} after {time[row]} "
            f"({len(falling)} such); allowed are increasing times"
        )
