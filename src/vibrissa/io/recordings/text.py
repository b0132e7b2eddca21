"""CSV and similar text, with the columns that [recording] names; other columns are ignored."""

from collections.abc import Sequence
from pathlib import Path
from re import match

from vibrissa.files import InputError, cells_of, check_header, numbers_of, reading, split, text_of
from vibrissa.io.recordings.formats import Columns, matched
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.units import is_unit

_COMMENTS = ("#", "%")
DELIMITERS = ",;\t| "
_MISSING = ("", "nan", "na", "n/a", "#n/a", "null", "none")
# Loggers put up to a few dozen lines before the header line.
LONGEST_PREAMBLE = 200


def columns(
    file: Path,
    table: RecordingTable,
    wanted: Sequence[str],
    exactly: Sequence[str] = (),
) -> Columns:
    """Read columns of a text file.

    Parameters
    ----------
    file
        Text with a header line of names, optionally a line of units, then one line per sample.
        Lines before the header, blank lines, comments (# or %) and empty rows at the end are
        skipped.
    table
        Encoding, delimiter (by default the one that separates most of the wanted names), decimal
        sign, and the number of lines to skip before looking for the header.
    wanted
        The columns to read; missing ones are left out.
    exactly
        The names that the file must have, no others and in this order; then every line is a row,
        and the delimiter is a comma, or the one given by Excel's line `sep=;`.

    Raises
    ------
    InputError
        If the file cannot be read, is not text, has no header line, a repeated name or no rows, a
        line is cut off, or a cell is not a number. Empty cells, NA and null become NaN.
    """
    if table.decimal == table.delimiter:
        raise InputError(
            f"{file}: decimal = ',' with delimiter = ','; allowed is another delimiter"
        )
    text = text_of(file, table.encoding.replace("utf-8", "utf-8-sig"))
    lines = text.splitlines()
    with reading(file, "text"):
        line, names, delimiter = _header(file, lines, table, wanted, exactly)
    chosen = matched(wanted, names)
    twice = [own for own in chosen.values() if names.count(own) > 1]
    if exactly:
        found = [name.lower() for name in names]
        hint = "; for another layout add a table [recording] to the setup"
        check_header(file, found, exactly, line=line + 1, hint=hint)
    elif twice:
        raise InputError(
            f"{file}, line {line + 1}: column {twice[0]!r} occurs {names.count(twice[0])} times; "
            "allowed is once"
        )
    places = {name: names.index(own) for name, own in chosen.items()}
    with reading(file, "text"):
        units = {} if exactly else _units(lines[line + 1 : line + 2], names, delimiter, places)
        skip, comments = line + 1 + bool(units), None if exactly else _COMMENTS
        cells = cells_of(
            file,
            text,
            names,
            delimiter=delimiter,
            decimal=table.decimal,
            skip=skip,
            comments=comments,
        )
    times = {one.time[0]: one.time_unit for one in (table, table.of_poses)}
    german = ", with decimal = ',' in [recording] where a comma is meant"
    arrays = {
        name: numbers_of(
            file,
            name,
            cells[place],
            missing=_MISSING,
            decimal=table.decimal,
            dates=times.get(name) == "stamp",
            hint=german * (table.decimal == "." and delimiter != ","),
        )
        for name, place in places.items()
    }
    return Columns(file, names, arrays, units, cells.index.to_numpy())


def _header(
    file: Path,
    lines: Sequence[str],
    table: RecordingTable,
    wanted: Sequence[str],
    exactly: Sequence[str],
) -> tuple[int, list[str], str]:
    """Index of the header line, from 0, its names, and the delimiter: the first line with the most
    wanted names, for the delimiter that gives the most; a comment, as NumPy writes it, only if it
    has more of them than any other line.
    """
    delimiters, skip = table.delimiter or DELIMITERS.replace(table.decimal, ""), table.skip_lines
    if exactly:
        stated = match(r'"?sep=(.)', "".join(lines[:1]))
        delimiters = stated[1] if stated else ","
    looked_at = list(enumerate(lines[skip : skip + LONGEST_PREAMBLE], skip))
    filled = [(number, line) for number, line in looked_at if line.strip("#% \t")]
    if not filled:
        raise InputError(
            f"{file}: {f'{len(lines)} lines' if lines else 'empty'}; allowed is CSV with the "
            f"columns {','.join(exactly or wanted[:1])} after skip_lines = {skip}"
        )

    sought = [_folded(name).strip("/") for name in wanted]
    folded = [_folded(line) for _, line in filled]
    promising = [
        numbered
        for numbered, line in zip(filled, folded, strict=True)
        if any(name in line for name in sought)
    ]
    found = [
        (number, [name.strip() for name in split(line.lstrip("#% \t"), delimiter)], delimiter)
        for number, line in promising or filled[:1]
        for delimiter in delimiters
    ]

    def score(header: tuple[int, list[str], str]) -> tuple[int, bool]:
        is_plain = not lines[header[0]].lstrip().startswith(_COMMENTS)
        return len(matched(wanted, header[1])), is_plain

    number, names, delimiter = max(found, key=score)
    while len(names) > 1 and not names[-1]:
        names.pop()
    return number, names, delimiter


def _folded(text: str) -> str:
    """A text, or a part of it, without case and quotes."""
    return text.replace('"', "").casefold()


def _units(
    below: Sequence[str], names: Sequence[str], delimiter: str, places: dict[str, int]
) -> dict[str, str]:
    """Units by name, if the line below the header has no number in any of the columns, and a unit
    in at least one.
    """
    cells = [cell.strip(" []()") for line in below for cell in split(line, delimiter)]
    if len(cells) < len(names):
        return {}
    said = {name: cells[place] for name, place in places.items()}
    is_row = any(cell[:1].isdigit() for cell in said.values())
    return said if not is_row and any(map(is_unit, said.values())) else {}
