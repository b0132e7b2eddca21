"""Text as loggers, spreadsheets and scripts leave it; and what names and files say of units, orders
and stamps.
"""

from pathlib import Path

import h5py
import numpy as np
import pytest
from bench_files import RECORDING
from mcap_files import mcap_bytes
from scipy.io import savemat
from test_recording_layout import LAYOUT, NAMES, TABLE, expected, load, same, text  # noqa: F401

import vibrissa as vb
from vibrissa.io import InputError
from vibrissa.io.recordings import units

LINES = RECORDING.splitlines()
ROWS = LINES[1:]


def joined(*lines: str) -> str:
    return "\n".join(lines) + "\n"


TEXTS = {
    "NumPy's header": joined("# " + LINES[0], *ROWS),
    "comments": joined("# wire 7", "% of MATLAB", LINES[0], *ROWS[:9], "# a pause", *ROWS[9:]),
    "blank lines": joined("", LINES[0], *ROWS[:9], "", *ROWS[9:], "", ""),
    "a delimiter after each row": joined(LINES[0], *(row + "," for row in ROWS)),
    "a line of units": joined(LINES[0], "s,m,m,m,,,,,N,N,N,Nm,Nm,Nm", *ROWS),
    "a line of units in brackets": joined(
        LINES[0], "[s],[m],[m],[m],[-],[-],[-],[-],[N],[N],[N],[N m],[N m],[N m]", *ROWS
    ),
    "semicolons": joined(*LINES).replace(",", ";"),
    "tabulators": joined(*LINES).replace(",", "\t"),
    "bars": joined(*LINES).replace(",", "|"),
    "spaces": joined(*LINES).replace(",", "   "),
    "Windows": "\ufeff" + joined(*LINES).replace("\n", "\r\n"),
    "quoted cells": joined(*('"' + line.replace(",", '","') + '"' for line in LINES)),
    "quoted delimiters": joined(
        LINES[0] + ',"note, of whom"', *(row + ',"slow, ""again"""' for row in ROWS)
    ),
}


@pytest.mark.parametrize("what", TEXTS)
def test_text_of_many_writers_is_the_same_recording(
    tmp_path: Path,
    expected: vb.Reactions,  # noqa: F811
    what: str,
) -> None:
    (tmp_path / "a.csv").write_bytes(TEXTS[what].encode())
    same(vb.read_recording(tmp_path / "a.csv", load(tmp_path, LAYOUT)), expected)


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "cp1252"])
def test_encodings(tmp_path: Path, expected: vb.Reactions, encoding: str) -> None:  # noqa: F811
    (tmp_path / "a.csv").write_text(
        joined(LINES[0] + ",T [°C]", *(row + ",21" for row in ROWS)), encoding=encoding
    )
    same(
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, LAYOUT + f'encoding = "{encoding}"\n')
        ),
        expected,
    )
    with pytest.raises(InputError, match="not a text file"):
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, LAYOUT))


def test_lines_are_named_as_an_editor_counts_them(tmp_path: Path) -> None:
    lines = ["# first", "", LINES[0], *ROWS[:10], "# pause", *ROWS[10:]]
    lines[30] = lines[30].replace("0.600000000,0.800000000", "0.6,0.6")
    (tmp_path / "a.csv").write_text(joined(*lines))
    with pytest.raises(InputError, match=r"a\.csv, line 31: qx,qy,qz,qw"):
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, LAYOUT))


@pytest.mark.parametrize("layout", [LAYOUT, ""], ids=["recording", "no recording"])
@pytest.mark.parametrize("missing", ["NA", "null", "N/A", "NaN", ""])
def test_words_for_a_missing_number_mark_their_row(
    tmp_path: Path, missing: str, layout: str
) -> None:
    cells = ROWS[20].split(",")
    lines = [LINES[0], *ROWS[:20], ",".join([*cells[:8], missing, *cells[9:]]), *ROWS[21:]]
    (tmp_path / "a.csv").write_text(joined(*lines))
    found = vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout))
    assert np.flatnonzero(np.isnan(found.force).any(axis=1)).tolist() == [20]


@pytest.mark.parametrize("channels", [slice(8, 14), slice(1, 14)], ids=["wrench", "all"])
@pytest.mark.parametrize("layout", [LAYOUT, ""], ids=["recording", "no recording"])
def test_a_log_without_readings_says_so(tmp_path: Path, channels: slice, layout: str) -> None:
    table = TABLE.copy()
    table[:, channels] = np.nan
    (tmp_path / "a.csv").write_text(text(table))
    with pytest.raises(InputError, match=r"a\.csv: no row holds readings; allowed are rows"):
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout))


def scaled_names(form: str) -> tuple[list[str], str]:
    """Names with their units, and the layout that asks for them and says nothing of units."""
    unit = ["ms", *["mm"] * 3, *[""] * 4, *["mN"] * 3, *["N mm"] * 3]
    names = [form.format(name, one) if one else name for name, one in zip(NAMES, unit, strict=True)]
    keys = {"position": names[1:4], "force": names[8:11], "torque": names[11:]}
    return names, "\n".join(
        [
            "[recording]",
            f"time = {names[0]!r}",
            *(f"{key} = {named}" for key, named in keys.items()),
        ]
    ) + "\n"


SCALED = TABLE * np.array([1e3, 1e3, 1e3, 1e3, 1, 1, 1, 1, *[1e3] * 6])


@pytest.mark.parametrize("form", ["{} [{}]", "{} ({})", "{}[{}]"])
def test_units_in_names_are_used_and_held_against_the_setup(
    tmp_path: Path,
    expected: vb.Reactions,  # noqa: F811
    form: str,
) -> None:
    names, layout = scaled_names(form)
    (tmp_path / "a.csv").write_text(text(SCALED, names))
    same(vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout)), expected)
    with pytest.raises(InputError, match="force_unit = 'N', but the file says 'mN'"):
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout + 'force_unit = "N"\n'))


def test_units_below_the_names_are_used(tmp_path: Path, expected: vb.Reactions) -> None:  # noqa: F811
    lines = text(SCALED).splitlines()
    (tmp_path / "a.csv").write_text(
        joined(lines[0], "ms,mm,mm,mm,,,,,mN,mN,mN,Nmm,Nmm,Nmm", *lines[1:])
    )
    same(vb.read_recording(tmp_path / "a.csv", load(tmp_path, "[recording]\n")), expected)


def test_a_unit_that_is_not_known_is_no_si_unit(tmp_path: Path) -> None:
    """An attribute that says slugs is not to be taken for newtons; a setup that says what they are
    goes before it.
    """
    with h5py.File(tmp_path / "a.h5", "w") as opened:
        for name, column in zip(NAMES, TABLE.T, strict=True):
            opened[name] = column
        opened["fx"].attrs["units"] = "slugs"
    with pytest.raises(InputError, match="the file says that force is in 'slugs'; known are N, mN"):
        vb.read_recording(tmp_path / "a.h5", load(tmp_path))
    vb.read_recording(tmp_path / "a.h5", load(tmp_path, LAYOUT))


def test_hours_and_kilogram_force_of_a_file_are_converted(
    tmp_path: Path,
    expected: vb.Reactions,  # noqa: F811
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as opened:
        for name, column in zip(
            NAMES,
            (TABLE / np.array([3600, *[1] * 7, *[9.80665] * 3, *[0.0980665] * 3])).T,
            strict=True,
        ):
            opened[name] = column
        opened["time"].attrs["units"] = "hours"
        for axis in "xyz":
            opened[f"f{axis}"].attrs["units"], opened[f"t{axis}"].attrs["units"] = "kgf", "kgf cm"
    same(vb.read_recording(tmp_path / "a.h5", load(tmp_path)), expected)


def test_degrees_are_not_taken_for_radians(tmp_path: Path) -> None:
    table = np.column_stack(
        [TABLE[:, :4], np.full((len(TABLE), 3), [0.0, 10.0, 106.0]), TABLE[:, 8:]]
    )
    (tmp_path / "a.csv").write_text(text(table, [*NAMES[:4], "A", "B", "C", *NAMES[8:]]))
    layout = '[recording]\norientation = ["A", "B", "C"]\norientation_form = "roll_pitch_yaw"\n'
    with pytest.raises(
        InputError, match=r"reaches 106 rad, as if in degrees; allowed are radians, or angle_unit"
    ):
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout))
    vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout + 'angle_unit = "deg"\n'))


def test_names_of_a_quaternion_have_the_order_of_its_form(
    tmp_path: Path,
    expected: vb.Reactions,  # noqa: F811
) -> None:
    (tmp_path / "a.csv").write_text(RECORDING)
    named = '[recording]\norientation = ["qw", "qx", "qy", "qz"]\n'
    with pytest.raises(
        InputError, match="allowed are names in the order of the form, or the form 'wxyz'"
    ):
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, named))
    same(
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, named + 'orientation_form = "wxyz"\n')
        ),
        expected,
    )
    with pytest.raises(InputError, match="or the form 'xyzw'"):
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, '[recording]\norientation_form = "wxyz"\n')
        )


def test_seconds_and_nanoseconds_in_two_columns(tmp_path: Path, expected: vb.Reactions) -> None:  # noqa: F811
    start = 1_700_000_000
    stamps = [divmod(start * 10**9 + round(time * 1e9), 10**9) for time in TABLE[:, 0]]
    rows = [
        f"{seconds},{rest},{row.split(',', 1)[1]}"
        for (seconds, rest), row in zip(stamps, ROWS, strict=True)
    ]
    (tmp_path / "a.csv").write_text(joined("sec,nanosec," + LINES[0].split(",", 1)[1], *rows))
    found = vb.read_recording(
        tmp_path / "a.csv", load(tmp_path, '[recording]\ntime = ["sec", "nanosec"]\n')
    )
    np.testing.assert_allclose(found.time - start, expected.time, rtol=0, atol=3e-7)
    np.testing.assert_array_equal(found.force, expected.force)


def test_matrices_with_a_column_a_sample(tmp_path: Path, expected: vb.Reactions) -> None:  # noqa: F811
    parts = {
        "position": TABLE[:, 1:4],
        "orientation": TABLE[:, 4:8],
        "force": TABLE[:, 8:11],
        "torque": TABLE[:, 11:],
    }
    savemat(
        tmp_path / "a.mat", {"time": TABLE[:, 0]} | {name: part.T for name, part in parts.items()}
    )
    same(vb.read_recording(tmp_path / "a.mat", load(tmp_path)), expected)


def test_a_pose_file_may_have_another_layout(tmp_path: Path, expected: vb.Reactions) -> None:  # noqa: F811
    (tmp_path / "ft.csv").write_text(text(TABLE[:, [0, *range(8, 14)]], [NAMES[0], *NAMES[8:]]))
    robot = text(TABLE[:, :8], NAMES[:8], ";").replace(".", ",")
    (tmp_path / "robot.csv").write_text("Roboter 7\nkalt\n" + robot)
    layout = '[recording]\npose_file = "robot.csv"\npose_decimal = ","\npose_skip_lines = 2\n'
    same(vb.read_recording(tmp_path / "ft.csv", load(tmp_path, layout)), expected)


def test_wrenches_of_a_bag_with_poses_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(mcap_bytes(rows=12))
    alone = vb.io.read_raw(tmp_path / "a.mcap", load(tmp_path)).raw
    moved = alone.position + [0.5, 0.0, 0.0]
    (tmp_path / "robot.csv").write_text(
        text(np.column_stack([alone.time, moved, alone.orientation]), NAMES[:8])
    )
    found = vb.io.read_raw(
        tmp_path / "a.mcap", load(tmp_path, '[recording]\npose_file = "robot.csv"\n')
    ).raw
    np.testing.assert_allclose(found.position, moved, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.force, alone.force)


@pytest.mark.parametrize("words", [["decimal = ','", "where a comma is meant"]])
def test_a_decimal_comma_that_is_not_told_is_pointed_out(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "a.csv").write_text(RECORDING.replace(",", ";").replace(".", ","))
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, LAYOUT))
    assert [word for word in words if word not in str(caught.value)] == []


ENDLESS = {
    "comments": "#\n" * 300_000,
    "blank lines": "\n" * 300_000,
    "an open quote": '"' + "a" * 300_000 + "\n1\n",
    "a long cell": joined(LINES[0], '"1",' * 13 + '"' + "1" * 300_000 + '"'),
    "a comment with all names, again and again": ("# " + LINES[0] + "\n") * 20_000,
}


@pytest.mark.parametrize("what", ENDLESS)
def test_text_without_a_recording_is_refused_in_one_line(tmp_path: Path, what: str) -> None:
    (tmp_path / "a.csv").write_text(ENDLESS[what])
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, LAYOUT))
    assert len(str(caught.value)) < 2000
    assert "a.csv" in str(caught.value)


CAPITALS = LINES[0].title()
COMMAS = ",,,,,,,,,,,,,"
NATURAL = {
    "Excel's line sep=": joined("sep=;", *(line.replace(",", ";") for line in LINES)),
    "Excel's line sep=, quoted": joined('"sep=;"', *(line.replace(",", ";") for line in LINES)),
    "Excel's line sep= of a comma": joined("sep=,", *LINES),
    "a preamble": joined("Sensor SN 4711", "Date,2026-11-21", "", "Operator: A", *LINES),
    "empty rows at the end": joined(*LINES, COMMAS, COMMAS),
    "empty rows at the end, without a line end": joined(*LINES, COMMAS) + COMMAS,
    "blank lines at the end": joined(*LINES, "", "  ", ""),
    "capitals in names": joined(CAPITALS, *ROWS),
    "all names in capitals": joined(LINES[0].upper(), *ROWS),
    "a trailing comma in each line": joined(*(line + "," for line in LINES)),
    "a trailing comma in the rows": joined(LINES[0], *(row + "," for row in ROWS)),
    "a trailing comma in the line of names": joined(LINES[0] + ",", *ROWS),
    "trailing commas and a space": joined(*(line + ",, " for line in LINES)),
    "all of it": joined(
        "sep=;",
        "Sensor SN 4711;",
        *((line + ",").replace(",", ";") for line in (CAPITALS, *ROWS)),
        COMMAS.replace(",", ";"),
    ),
}


@pytest.mark.parametrize("layout", ["", LAYOUT])
@pytest.mark.parametrize("what", NATURAL)
def test_natural_exports_are_read(
    tmp_path: Path,
    expected: vb.Reactions,  # noqa: F811
    what: str,
    layout: str,
) -> None:
    """By a setup without [recording], whose file is to be comma-separated, and by one with it."""
    (tmp_path / "a.csv").write_text(NATURAL[what])
    same(vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout)), expected)


def test_lines_behind_a_preamble_are_named_as_an_editor_counts_them(tmp_path: Path) -> None:
    lines = joined("Sensor SN 4711", "", *LINES).replace("0.005000", "here", 1)
    (tmp_path / "a.csv").write_text(lines)
    for layout in ("", LAYOUT):
        with pytest.raises(InputError, match=r"a\.csv, line 4: py = 'here'"):
            vb.read_recording(tmp_path / "a.csv", load(tmp_path, layout))


@pytest.mark.parametrize(
    "spelling",
    [
        "N*mm",
        "Nmm",
        "N.mm",
        "N·mm",
        "N mm",
        "N-mm",
        "NMM",
        "n*mm",
        "mN m",
        "mNm",
        "newton millimeter",
    ],
)
@pytest.mark.parametrize("place", ["names", "line below", "attribute"])
def test_spellings_of_a_newton_millimetre(
    tmp_path: Path,
    expected: vb.Reactions,  # noqa: F811
    spelling: str,
    place: str,
) -> None:
    table = TABLE * np.array([*[1] * 11, *[1e3] * 3])
    names, layout = list(NAMES), "[recording]\n"
    file = tmp_path / ("a.h5" if place == "attribute" else "a.csv")
    if place == "names":
        names[11:] = [f"{name} [{spelling}]" for name in NAMES[11:]]
        layout += f"torque = {names[11:]}\n"
    content = text(table, names).splitlines()
    if place == "line below":
        content.insert(1, "s,m,m,m,,,,,N,N,N," + ",".join([spelling] * 3))
    file.write_text(joined(*content))
    if place == "attribute":
        with h5py.File(file, "w") as opened:
            for name, column in zip(NAMES, table.T, strict=True):
                opened[name] = column
            for name in NAMES[11:]:
                opened[name].attrs["units"] = spelling
    same(vb.read_recording(file, load(tmp_path, layout)), expected)


def test_capitals_in_units(tmp_path: Path, expected: vb.Reactions) -> None:  # noqa: F811
    lines = text(SCALED).splitlines()
    said = "MS,MM,MM,MM,,,,,mN,mN,mN,NMM,NMM,NMM"
    (tmp_path / "a.csv").write_text(joined(lines[0].upper(), said, *lines[1:]))
    same(vb.read_recording(tmp_path / "a.csv", load(tmp_path, "[recording]\n")), expected)


@pytest.mark.parametrize(
    ("unit", "read"), [("KN", "kN"), ("Newton", "N"), ("LBF", "lbf"), ("kp", "kgf")]
)
def test_units_by_their_meaning(unit: str, read: str) -> None:
    assert units.known(unit, units.FORCE) == read


def test_capitals_that_mean_another_unit_are_not_guessed() -> None:
    """A meganewton is none that a whisker's sensor shows, and not to be taken for a millinewton."""
    with pytest.raises(ValueError, match="'MN'; known are N, mN"):
        units.known("MN", units.FORCE)
    with pytest.raises(ValueError, match="known are m, cm, mm"):
        units.known("kg", units.LENGTH)
