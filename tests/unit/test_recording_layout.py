"""The table [recording]: names, units, forms of orientation, stamps; and poses on stamps of their
own.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_files import HEADER, RECORDING, SETUP
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io import InputError, RecordingWarning, read_raw
from vibrissa.io.recordings.streams import Poses, in_gap, interpolated
from vibrissa.io.recordings.units import FORCE, LENGTH, TORQUE, factor

NAMES = HEADER.split(",")
TABLE = np.genfromtxt(RECORDING.splitlines()[1:], delimiter=",")
LAYOUT = '[recording]\nforce_unit = "N"\n'


def load(folder: Path, recording: str = "") -> vb.Setup:
    file = folder / "setup.toml"
    file.write_text(SETUP + recording)
    return vb.load_setup(file)


def text(table: np.ndarray, names: list[str] = NAMES, delimiter: str = ",") -> str:
    return (
        "\n".join(
            [delimiter.join(names), *(delimiter.join(map(repr, map(float, row))) for row in table)]
        )
        + "\n"
    )


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> vb.Reactions:
    folder = tmp_path_factory.mktemp("expected")
    (folder / "expected.csv").write_text(RECORDING)
    return vb.read_recording(folder / "expected.csv", load(folder))


def same(found: vb.Reactions, expected: vb.Reactions) -> None:
    np.testing.assert_allclose(found.time, expected.time, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.force, expected.force, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.moment, expected.moment, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.trail.position, expected.trail.position, rtol=0, atol=1e-10)
    turned = Rotation.from_quat(found.trail.orientation).inv() * Rotation.from_quat(
        expected.trail.orientation
    )
    assert np.max(turned.magnitude()) < 1e-7


def scaled(columns: slice, factor: float) -> np.ndarray:
    table = TABLE.copy()
    table[:, columns] /= factor
    return table


@pytest.mark.parametrize("unit", FORCE)
def test_units_of_force(tmp_path: Path, expected: vb.Reactions, unit: str) -> None:
    (tmp_path / "a.csv").write_text(text(scaled(slice(8, 11), factor(unit))))
    same(
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, f'[recording]\nforce_unit = "{unit}"\n')
        ),
        expected,
    )


@pytest.mark.parametrize("unit", TORQUE)
def test_units_of_torque(tmp_path: Path, expected: vb.Reactions, unit: str) -> None:
    (tmp_path / "a.csv").write_text(text(scaled(slice(11, 14), factor(unit))))
    same(
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, f'[recording]\ntorque_unit = "{unit}"\n')
        ),
        expected,
    )


@pytest.mark.parametrize("unit", LENGTH)
def test_units_of_length(tmp_path: Path, expected: vb.Reactions, unit: str) -> None:
    (tmp_path / "a.csv").write_text(text(scaled(slice(1, 4), factor(unit))))
    same(
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, f'[recording]\nposition_unit = "{unit}"\n')
        ),
        expected,
    )


def test_units_are_those_of_their_definitions() -> None:
    """The international foot and pound (1959), and standard gravity (1901)."""
    inch, pound, gravity = 0.0254, 0.45359237, 9.80665
    assert factor("lbf") == pytest.approx(pound * gravity, rel=1e-14)
    assert factor("gf") == pytest.approx(1e-3 * gravity, rel=1e-14)
    assert factor("lbf in") == pytest.approx(pound * gravity * inch, rel=1e-14)
    assert factor("in") == inch


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_units_of_time(tmp_path: Path, expected: vb.Reactions, unit: str, factor: float) -> None:
    (tmp_path / "a.csv").write_text(text(scaled(slice(0, 1), factor)))
    same(
        vb.read_recording(
            tmp_path / "a.csv", load(tmp_path, f'[recording]\ntime_unit = "{unit}"\n')
        ),
        expected,
    )


@pytest.mark.parametrize("zone", ["Z", "+00:00", "", "+05:30"])
def test_dates(tmp_path: Path, expected: vb.Reactions, zone: str) -> None:
    """Seconds since 1970; without a zone, in universal time."""
    lines = [line.split(",", 1) for line in RECORDING.splitlines()[1:]]
    rows = [f"2026-11-21T20:00:{float(time):09.6f}{zone},{rest}" for time, rest in lines]
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    found = vb.read_recording(
        tmp_path / "a.csv", load(tmp_path, '[recording]\ntime_unit = "stamp"\n')
    )
    start = np.datetime64("2026-11-21T20:00:00").astype("datetime64[s]").astype(np.int64) - (
        5.5 * 3600 if "5" in zone else 0
    )
    np.testing.assert_allclose(found.time - start, expected.time, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found.force, expected.force)


def test_names_order_delimiter_decimal_comma_preamble_and_columns_of_no_use(
    tmp_path: Path, expected: vb.Reactions
) -> None:
    """As a spreadsheet of another country leaves it."""
    names = ["Kommentar", *(f"{name} [SI]" for name in NAMES[::-1])]
    rows = [
        ";".join(["ab, c", *(f"{value:.9f}".replace(".", ",") for value in row[::-1])])
        for row in TABLE
    ]
    (tmp_path / "a.txt").write_text(
        "\n".join(["Messung vom 21.11.", "", ";".join(names), *rows]) + "\n", encoding="utf-8"
    )
    keys = {
        "time": NAMES[:1],
        "position": NAMES[1:4],
        "orientation": NAMES[4:8],
        "force": NAMES[8:11],
        "torque": NAMES[11:],
    }
    lines = [
        f"{key} = {[f'{name} [SI]' for name in named] if key != 'time' else repr('time [SI]')}"
        for key, named in keys.items()
    ]
    layout = (
        "\n".join(["[recording]", *lines, 'delimiter = ";"', 'decimal = ","', "skip_lines = 2"])
        + "\n"
    )
    same(vb.read_recording(tmp_path / "a.txt", load(tmp_path, layout)), expected)


@pytest.mark.parametrize("form", ["wxyz", "rotation_vector", "roll_pitch_yaw"])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_forms_of_orientation(tmp_path: Path, form: str, unit: str) -> None:
    """Against SciPy's rotations, on turns of every axis."""
    turns = Rotation.from_rotvec(np.random.default_rng(2).uniform(-1, 1, (len(TABLE), 3)))
    quaternion = turns.as_quat()
    factor = 180 / np.pi if unit == "deg" else 1.0
    numbers = {
        "wxyz": quaternion[:, [3, 0, 1, 2]],
        "rotation_vector": factor * turns.as_rotvec(),
        # Fixed axes x, then y, then z: the matrix is Rz Ry Rx.
        "roll_pitch_yaw": factor * turns.as_euler("ZYX")[:, ::-1],
    }[form]
    names = [f"r{k}" for k in range(numbers.shape[1])]
    table = np.column_stack([TABLE[:, :4], numbers, TABLE[:, 8:]])
    (tmp_path / "a.csv").write_text(text(table, [*NAMES[:4], *names, *NAMES[8:]]))
    layout = (
        f'[recording]\norientation = {names}\norientation_form = "{form}"\nangle_unit = "{unit}"\n'
    )
    recording = read_raw(tmp_path / "a.csv", load(tmp_path, layout))
    found = Rotation.from_quat(recording.raw.orientation)
    assert np.max((found.inv() * turns).magnitude()) < 1e-12


def helix(time: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """A motion that linear and spherical interpolation follow exactly: constant velocity and
    constant angular velocity.
    """
    position = np.outer(time, [0.01, -0.02, 0.005]) + [0.1, 0, 0.2]
    return position, Rotation.from_rotvec(np.outer(time, [0.2, 0.5, -0.3])) * Rotation.from_quat(
        [0.1, 0.2, 0.3, 0.9]
    )


def poses(time: np.ndarray) -> np.ndarray:
    position, turn = helix(time)
    return np.column_stack([position, turn.as_quat()])


def test_interpolation_is_exact_on_a_uniform_screw_and_ends_at_the_ends() -> None:
    rng = np.random.default_rng(0)
    stamps = np.sort(rng.uniform(0, 5, 40))
    sign = np.where(rng.random(40) < 0.5, -1, 1)[:, None]
    pose = Poses(stamps, poses(stamps)[:, :3], sign * poses(stamps)[:, 3:])
    time = np.concatenate(
        [
            [stamps[0] - 1e-9, stamps[-1] + 1e-9, np.nan],
            stamps,
            rng.uniform(stamps[0], stamps[-1], 200),
        ]
    )
    found = interpolated(pose, time)
    assert np.isnan(found.position[:3]).all()
    assert np.isnan(found.orientation[:3]).all()
    position, turn = helix(time[3:])
    np.testing.assert_allclose(found.position[3:], position, atol=1e-14)
    assert np.max((Rotation.from_quat(found.orientation[3:]).inv() * turn).magnitude()) < 1e-12


def test_gaps_longer_than_allowed_have_no_pose_inside() -> None:
    stamps = np.array([0.0, 0.1, 0.5, 0.6])
    time = np.array([0.05, 0.1, 0.10001, 0.3, 0.49999, 0.5, 0.55])
    pose = Poses(stamps, *np.split(poses(stamps), [3], axis=1))
    assert np.flatnonzero(in_gap(pose, time, 0.2)).tolist() == [2, 3, 4]


def two_files(
    folder: Path, wrench_time: np.ndarray, pose_time: np.ndarray, offset: float = 0.0
) -> Path:
    """Wrenches in one file, poses in another whose clock is behind by `offset`."""
    wrench = np.column_stack([wrench_time, np.tile(TABLE[-1, 8:], (len(wrench_time), 1))])
    wrench[wrench_time < 0.9, 1:] = TABLE[0, 8:]
    (folder / "ft.csv").write_text(text(wrench, ["time", *NAMES[8:]]))
    (folder / "ft_tool.csv").write_text(
        text(np.column_stack([pose_time - offset, poses(pose_time)]), ["time", *NAMES[1:8]])
    )
    return folder / "ft.csv"


TWO_FILES = '[recording]\npose_file = "{name}_tool.csv"\n'


@pytest.mark.parametrize("offset", [0.0, 0.25, -1000.5])
def test_poses_of_another_file_rate_and_clock(tmp_path: Path, offset: float) -> None:
    """A pose stamped t belongs to the wrench stamped t + time_offset."""
    time = np.arange(0, 3, 0.004)
    file = two_files(tmp_path, time, np.arange(-0.5, 3.5, 0.013), offset)
    setup = load(tmp_path, TWO_FILES + f"time_offset = {offset}\n")
    found = vb.read_recording(file, setup)
    position, turn = helix(time)
    np.testing.assert_allclose(
        found.trail.position, position + turn.apply([0.001, 0.002, 0.025]), atol=1e-9
    )
    assert np.max((Rotation.from_quat(found.trail.orientation).inv() * turn).magnitude()) < 1e-9
    np.testing.assert_allclose(found.time, time, atol=1e-12)


def test_wrenches_beyond_the_poses_are_left_out_and_said_to_be(tmp_path: Path) -> None:
    time = np.arange(0, 3, 0.01)
    file = two_files(tmp_path, time, np.arange(0.2049, 2.5, 0.01))
    with pytest.warns(
        RecordingWarning, match=r"of 300 wrenches lie before the first or after the last pose"
    ):
        found = vb.read_recording(file, load(tmp_path, TWO_FILES))
    assert found.time is not None
    np.testing.assert_allclose(found.time, time[21:250], atol=1e-9)


def test_rows_in_a_gap_have_no_reactions_and_the_others_theirs(tmp_path: Path) -> None:
    time, pose_time = np.arange(0, 3, 0.01), np.arange(-0.1, 3.1, 0.01)
    file = two_files(tmp_path, time, pose_time[(pose_time < 1.5) | (pose_time > 2.0)])
    with pytest.warns(
        RecordingWarning,
        match=r"rows, first at 1.5 s, lie in gaps of the poses longer than longest_gap = 0.2 s",
    ):
        found = vb.read_recording(file, load(tmp_path, TWO_FILES))
    lost = np.isnan(found.force).all(axis=1)
    assert lost.sum() == pytest.approx(51, abs=1)
    assert np.all(np.abs(found.time[lost] - 1.75) < 0.26)
    assert np.isfinite(found.trail.position).all()
    marked = read_raw(file, load(tmp_path, TWO_FILES)).marked
    np.testing.assert_array_equal(np.isnan(marked.position).all(axis=1), lost)


def test_a_table_of_two_rates_has_empty_cells(tmp_path: Path) -> None:
    """Wrench and pose in one table, a row for whichever came: each stays on its stamps."""
    time = np.arange(0, 3, 0.01)
    rows = []
    for number, stamp in enumerate(time):
        wrench = TABLE[0 if stamp < 0.9 else -1, 8:]
        if number % 3 == 0:
            rows.append(
                (stamp + 0.001, [stamp + 0.001, *poses(np.array([stamp + 0.001]))[0]], [""] * 6)
            )
        rows.append((stamp + 0.002, [stamp + 0.002, *[""] * 7], list(wrench)))
    lines = [",".join(map(str, [*pose, *wrench])) for _, pose, wrench in rows]
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *lines]) + "\n")
    with pytest.warns(RecordingWarning) as caught:
        found = vb.read_recording(tmp_path / "a.csv", load(tmp_path, LAYOUT))
    assert any(
        "300 rows hold a wrench and 100 a pose, of 400" in str(one.message) for one in caught
    )
    position, turn = helix(found.time)
    assert len(found.time) > 290
    np.testing.assert_allclose(
        found.trail.position, position + turn.apply([0.001, 0.002, 0.025]), atol=1e-9
    )


WRONG: dict[str, tuple[str, Callable[[str], str], list[str]]] = {
    "a name that is not there": (
        'force = ["a", "b", "c"]',
        str,
        ["force = 'a' is not in the file; it holds time, px"],
    ),
    "a column twice": (
        'force_unit = "N"',
        lambda text: text.replace("time", "fx", 1),
        ["column 'fx' occurs 2 times"],
    ),
    "another delimiter": ('delimiter = ";"', str, ["is not in the file; it holds time,px,py"]),
    "a short line": (
        'force_unit = "N"',
        lambda text: text.replace("\n0.0500,", "\n", 1),
        ["line 2", "13 of 14 columns"],
    ),
    "a word": (
        'force_unit = "N"',
        lambda text: text.replace("0.005000", "here", 1),
        ["line 2", "py = 'here'", "allowed is a number"],
    ),
    "no date": (
        'time_unit = "stamp"',
        str,
        ["line 2", "time = '0.05'", "allowed is a date of ISO 8601"],
    ),
    "cut off": (
        'force_unit = "N"',
        lambda text: text[:-4],
        ["line 41", "tz", "the last line is truncated"],
    ),
    "more lines to skip than there are": ("skip_lines = 50", str, ["41 lines", "skip_lines = 50"]),
    "clocks that do not overlap": (
        "time_offset = 100.0",
        str,
        ["wrenches from 0.05 to 3.95 s, poses from 100.05 to 103.95 s", "time_offset"],
    ),
    "one sign for two purposes": (
        'decimal = ","\ndelimiter = ","',
        str,
        ["decimal = ',' with delimiter = ','"],
    ),
    "a pose file that is not there": ('pose_file = "none.csv"', str, ["none.csv: cannot be read"]),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_does_not_fit_is_named(tmp_path: Path, what: str) -> None:
    line, damage, words = WRONG[what]
    (tmp_path / "a.csv").write_text(damage(RECORDING))
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / "a.csv", load(tmp_path, f"[recording]\n{line}\n"))
    assert str(caught.value).startswith(str(tmp_path))
    assert [word for word in words if word not in str(caught.value)] == []


def test_an_empty_cell_marks_its_row(tmp_path: Path) -> None:
    lines = RECORDING.splitlines()
    cells = lines[20].split(",")
    lines[20] = ",".join([*cells[:2], "", *cells[3:]])
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    found = vb.read_recording(tmp_path / "a.csv", load(tmp_path, '[recording]\nforce_unit = "N"\n'))
    assert np.flatnonzero(np.isnan(found.force).any(axis=1)).tolist() == [19]


KEYS = {
    "colour = 1": "recording.colour: unknown key; allowed are time, time_unit, force",
    'force_unit = "kg"': "recording.force_unit = 'kg': allowed is one of N, mN, uN, kN, gf, kgf, lbf",
    "force = []": "recording.force = []: allowed is one name, of an array with a column for each, or a list of three names",
    'force = ["a", 1, "c"]': "recording.force[1] = 1: allowed is the name of a column, array or topic",
    'time_offset = "guess"': "recording.time_offset = 'guess': allowed is a finite number of seconds, or 'estimate'",
    "time_offset = nan": "recording.time_offset = nan: allowed is a finite number of seconds",
    "time_offset = true": "recording.time_offset = True: allowed is a finite number of seconds",
    "longest_gap = 0": "recording.longest_gap = 0: allowed is a number greater than 0",
    'orientation_form = "euler"': "recording.orientation_form = 'euler': allowed is xyzw or wxyz (quaternions), rotation_vector",
    "skip_lines = -1": "recording.skip_lines = -1: allowed is a whole number from 0 to 10,000",
    'delimiter = "ab"': "recording.delimiter = 'ab': allowed is a comma, semicolon",
}


@pytest.mark.parametrize("line", KEYS)
def test_wrong_keys_are_named(tmp_path: Path, line: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, f"[recording]\n{line}\n")
    assert KEYS[line] in str(caught.value)


def test_reading_alone_judges_nothing(tmp_path: Path) -> None:
    """Rows with NaN, stamps that stand or fall, and quaternions of no norm come through for whoever
    looks for faults.
    """
    lines = RECORDING.splitlines()
    lines[16] = lines[15]
    lines[20] = lines[20].replace("0.600000000,0.800000000", "0,0")
    cells = lines[30].split(",")
    cells[9] = "nan"
    lines[30] = ",".join(cells)
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    raw = read_raw(tmp_path / "a.csv", replace(load(tmp_path), recording=None)).raw
    assert len(raw.time) == 40
    assert np.diff(raw.time).min() == 0
    assert np.argwhere(np.isnan(raw.force)).tolist() == [[29, 1]]
    assert np.argwhere(np.linalg.norm(raw.orientation, axis=1) == 0).tolist() == [[19]]
