"""Recordings as CSV: read as the sensor's mount, sign and tare say, and refused in one line where
damaged.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_files import HEADER, RECORDING, ROWS, SETUP, TARE_ROWS, recording_table, recording_text
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io import InputError, inspect_recording


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> vb.Setup:
    file = tmp_path_factory.mktemp("setup") / "setup.toml"
    file.write_text(SETUP)
    return vb.load_setup(file)


def written(folder: Path, text: str | bytes) -> Path:
    file = folder / "trail.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def check(found: vb.Reactions) -> None:
    """Against the numbers that the recording was made of."""
    table = recording_table()
    pose, arm = (
        Rotation.from_quat([0, 0, 0.6, 0.8]),
        np.array([0.001, 0.002, 0.025]) - [0, 0, 0.001],
    )
    on_sensor = table[:, 8:14] - table[:TARE_ROWS, 8:14].mean(axis=0)
    at_clamp = on_sensor[:, 3:] - np.cross(arm, on_sensor[:, :3])
    np.testing.assert_allclose(found.time, table[:, 0], atol=1e-12)
    np.testing.assert_allclose(found.force, -pose.apply(on_sensor[:, :3]), rtol=0, atol=2e-5)
    np.testing.assert_allclose(found.moment, -pose.apply(at_clamp), rtol=0, atol=6e-7)
    np.testing.assert_allclose(
        found.trail.position, table[:, 1:4] + pose.apply([0.001, 0.002, 0.025]), atol=1e-9
    )
    np.testing.assert_allclose(found.trail.orientation, [(0, 0, 0.6, 0.8)] * ROWS, atol=1e-12)


WAYS = {
    "as it is": RECORDING,
    "lines of another system": RECORDING.replace("\n", "\r\n"),
    "no end of the last line": RECORDING.rstrip("\n"),
    "byte order mark": "\ufeff" + RECORDING,
    "spaces": RECORDING.replace(",", ", "),
    "exponents": "\n".join(
        [HEADER, *(",".join(map(repr, row.tolist())) for row in recording_table())]
    )
    + "\n",
}


@pytest.mark.parametrize("way", WAYS)
def test_a_good_recording_is_read(tmp_path: Path, setup: vb.Setup, way: str) -> None:
    check(vb.read_recording(written(tmp_path, WAYS[way]), setup))


def test_noise_comes_with_it(tmp_path: Path, setup: vb.Setup) -> None:
    found = vb.read_recording(written(tmp_path, RECORDING), setup)
    assert found.covariance is not None
    tare = 1 + 1 / 9
    np.testing.assert_allclose(
        np.diag(found.covariance)[:3], tare * (4e-6 + 1.5625e-3**2 / 12), rtol=1e-12
    )
    np.testing.assert_allclose(found.position_covariance, 1e-10 * np.eye(3))


LINES = RECORDING.splitlines()


def with_cell(row: int, column: str, value: str) -> str:
    """The recording with one number replaced; rows count from 0."""
    cells = LINES[row + 1].split(",")
    cells[HEADER.split(",").index(column)] = value
    return "\n".join([*LINES[: row + 1], ",".join(cells), *LINES[row + 2 :]]) + "\n"


def scaled(columns: slice, factor: float) -> str:
    """Some columns in other units."""
    table = recording_table()
    table[:, columns] *= factor
    return recording_text(table)


TIME_BACK = "\n".join([*LINES[:20], LINES[21], LINES[20], *LINES[22:]]) + "\n"
DAMAGE: dict[str, tuple[str | bytes, list[str]]] = {
    "word": (with_cell(3, "tx", "overload"), ["line 5", "tx = 'overload'", "allowed is a number"]),
    "underscore": (
        with_cell(ROWS - 1, "tx", "0.01_35"),
        ["line 41", "tx = '0.01_35'", "allowed is a number"],
    ),
    "truncated last line": (RECORDING[:-40], ["line 41", "columns", "truncated"]),
    "truncated last number": (RECORDING[:-4], ["line 41", "tz", "truncated", "complete lines"]),
    "truncated to a comma": (RECORDING[: RECORDING.rindex(",") + 1], ["line 41", "tz"]),
    "a missing column": (RECORDING.replace(",qw", "", 1), ["line 1", "missing qw"]),
    "wrong names": (
        RECORDING.replace("fx,fy,fz", "f1,f2,f3", 1),
        ["missing fx, fy, fz", "unknown f1, f2, f3", HEADER],
    ),
    "another order": (
        RECORDING.replace("px,py", "py,px", 1),
        ["line 1", "another order", f"allowed are {HEADER}"],
    ),
    "no header": ("\n".join(LINES[1:]) + "\n", ["line 1", "columns", f"allowed are {HEADER}"]),
    "semicolons": (RECORDING.replace(",", ";"), ["line 1", f"allowed are {HEADER}"]),
    "time backwards": (
        TIME_BACK,
        ["line 22", "time = 1.95 after 2.05", "allowed are increasing times"],
    ),
    "zero quaternion": (with_cell(7, "qz", "0"), ["line 9", "qx,qy,qz,qw", "allowed is 1"]),
    "no rotation at all": (
        RECORDING.replace("0.600000000,0.800000000", "0,0"),
        ["line 2", "norm 0 (40 such)"],
    ),
    "no rows": (HEADER + "\n", ["no rows", "at least one sample"]),
    "empty": ("", ["empty", f"allowed is CSV with the columns {HEADER}"]),
    "a gap": (
        "\n".join([*LINES[:9], "", *LINES[9:]]) + "\n",
        ["line 10", "1 of 14 columns", "allowed are 14 numbers"],
    ),
    "one number more": (
        RECORDING.replace("\n0.0500,", "\n0.0500,0,", 1),
        ["line 2", "15 of 14 columns"],
    ),
    "another encoding": (
        RECORDING.encode("utf-16"),
        ["not a text file", "allowed is CSV in UTF-8"],
    ),
    "rest too short": (
        "\n".join(LINES[:2]) + "\n",
        ["tare_seconds = 0.85: 1 of 1 samples", "allowed are at least 2"],
    ),
    "millimetres": (scaled(slice(1, 4), 1e3), ["px,py,pz", "allowed are metres"]),
    "newton millimetres": (
        scaled(slice(11, 14), 1e3),
        ["tx,ty,tz", "mis-scaled", "torques in N mm", "allowed are N, N m"],
    ),
    "millinewtons": (scaled(slice(8, 14), 1e3), ["force", "mis-scaled"]),
    "kilonewtons": (scaled(slice(8, 14), 1e-3), ["force", "mis-scaled"]),
}


def refusal(read: Callable[[], object], file: Path) -> str:
    with pytest.raises(InputError) as caught:
        read()
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(file))
    return message


@pytest.mark.parametrize("what", DAMAGE)
def test_damage_is_named(tmp_path: Path, setup: vb.Setup, what: str) -> None:
    content, words = DAMAGE[what]
    file = written(tmp_path, content)
    message = refusal(lambda: vb.read_recording(file, setup), file)
    assert [word for word in words if word not in message] == [], message


def test_every_damage_is_told_from_the_others(tmp_path: Path, setup: vb.Setup) -> None:
    messages = set()
    for content, _ in DAMAGE.values():
        file = written(tmp_path, content)
        try:
            vb.read_recording(file, setup)
        except InputError as error:
            messages.add(str(error))
        else:
            messages.add("taken for good")
    assert "taken for good" not in messages
    assert len(messages) == len(DAMAGE)


def test_a_missing_file_or_a_folder_cannot_be_read(tmp_path: Path, setup: vb.Setup) -> None:
    for file, reason in ((tmp_path / "none.csv", "No such file"), (tmp_path, "Is a directory")):
        message = refusal(lambda file=file: vb.read_recording(file, setup), file)
        assert f"cannot be read ({reason}" in message


MARKED = {
    "not a number": (with_cell(15, "fy", "nan"), 15, "drop-out"),
    "infinite": (with_cell(3, "tx", "inf"), 3, "drop-out"),
    "no place": (with_cell(15, "px", "nan"), 15, "drop-out"),
    "no turn": (with_cell(15, "qz", "nan"), 15, "drop-out"),
    "no stamp": (with_cell(15, "time", "nan"), 15, "drop-out"),
    "time standing": (with_cell(20, "time", "1.9500"), 20, "duplicate stamp"),
    "a line twice": (
        "\n".join([*LINES[:21], LINES[20], *LINES[21:]]) + "\n",
        20,
        "duplicate stamp",
    ),
}


@pytest.mark.parametrize("what", MARKED)
def test_a_bad_row_is_marked_and_the_others_are_kept(
    tmp_path: Path, setup: vb.Setup, what: str
) -> None:
    content, row, kind = MARKED[what]
    file = written(tmp_path, content)
    found, good = (
        vb.read_recording(file, setup),
        vb.read_recording(written(tmp_path, RECORDING), setup),
    )
    file.write_text(content)
    lost = np.isnan(found.force).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [row]
    assert np.all(np.diff(found.time) > 0)
    kept = np.delete(np.arange(len(found.force)), row)
    same = np.arange(ROWS) if len(found.force) > ROWS else kept
    np.testing.assert_allclose(
        found.force[kept], good.force[same], rtol=0, atol=1e-4 if row < TARE_ROWS else 1e-12
    )
    assert [
        str(fault.kind)
        for fault in inspect_recording(file, setup).faults
        if fault.kind in {"drop-out", "duplicate stamp"}
    ] == [kind]
    contacts = vb.reconstruct(setup.rod, found, check=False)
    assert contacts.status[row] == vb.Status.BAD_DATA
    assert np.count_nonzero(contacts.status == vb.Status.BAD_DATA) == 1
