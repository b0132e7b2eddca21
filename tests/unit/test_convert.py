"""`vibrissa convert`: what is written reads back to the same reactions, in every format."""

from pathlib import Path

import numpy as np
import pytest
from bench_files import HEADER, SETUP, recording_table
from command_line import vibrissa

import vibrissa as vb
from vibrissa.contacts import RecordingNote

EXAMPLES = Path(__file__).parents[2] / "examples/recordings/sphere_60mm"
LAYOUT = """
[recording]
time = "t"
time_unit = "ms"
force = ["Fx", "Fy", "Fz"]
force_unit = "mN"
torque = ["Mx", "My", "Mz"]
torque_unit = "N mm"
position = ["X", "Y", "Z"]
position_unit = "mm"
orientation = ["Qw", "Qx", "Qy", "Qz"]
orientation_form = "wxyz"
delimiter = ";"
"""
TARGETS = ["x.csv", "x.parquet", "x.nc", "x.mat", "x.mcap", "rosbag2:x"]


@pytest.fixture
def foreign(tmp_path: Path) -> tuple[Path, Path]:
    """A log in other units, order and names, of a wrench on the rod in world axes, and its setup."""
    table = recording_table()
    columns = [
        1e3 * table[:, :1], 1e3 * table[:, 1:4], table[:, [7, 4, 5, 6]],
        1e3 * table[:, 8:11], 1e3 * table[:, 11:],
    ]  # fmt: skip
    header = "t;X;Y;Z;Qw;Qx;Qy;Qz;Fx;Fy;Fz;Mx;My;Mz"
    log, setup = tmp_path / "log.csv", tmp_path / "setup.toml"
    np.savetxt(log, np.hstack(columns), fmt="%.17g", delimiter=";", header=header, comments="")
    text = SETUP.replace('"on_sensor"', '"on_rod"').replace('= "sensor"', '= "world"')
    setup.write_text(text + LAYOUT, encoding="utf-8")
    return log, setup


@pytest.mark.parametrize("target", TARGETS)
def test_units_signs_and_frames_read_back(
    foreign: tuple[Path, Path],
    target: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log, setup = foreign
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    for _ in range(2):  # it can be run twice
        run = vibrissa(capsys, "convert", log, "--setup", setup, "-o", target)
        assert run.status == 0, run.err
    name = target.removeprefix("rosbag2:")
    assert run.out == f"40 rows → {name}, x_setup.toml\n"
    assert "[recording]" not in Path("x_setup.toml").read_text(encoding="utf-8")
    fitting = vb.load_setup("x_setup.toml")
    expected = vb.read_recording(log, vb.load_setup(setup))
    got = vb.read_recording(name, fitting)
    np.testing.assert_allclose(got.force, expected.force, rtol=0, atol=1e-12)
    np.testing.assert_allclose(got.moment, expected.moment, rtol=0, atol=1e-12)
    np.testing.assert_allclose(got.time, expected.time, rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.trail.position, expected.trail.position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        got.trail.orientation, expected.trail.orientation, rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("target", TARGETS)
def test_the_shipped_recording_needs_no_other_setup(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    log, setup = EXAMPLES / "trail.csv", EXAMPLES / "setup.toml"
    run = vibrissa(capsys, "convert", log, "--setup", setup, "-o", target)
    name = target.removeprefix("rosbag2:")
    assert (run.status, run.out) == (0, f"901 rows → {name}\n")
    loaded = vb.load_setup(setup)
    expected, got = (vb.read_recording(file, loaded) for file in (log, name))
    np.testing.assert_allclose(got.wrench, expected.wrench, rtol=0, atol=1e-12)


def test_what_is_converted_is_never_replaced(
    foreign: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    log, setup = foreign
    before = log.read_bytes(), setup.read_bytes()
    for target in (log, log.with_suffix(".xyz")):
        run = vibrissa(capsys, "convert", log, "--setup", setup, "-o", target)
        assert (run.status, run.out) == (2, "")
        assert "allowed" in run.err
    own = setup.rename(setup.with_name("new_setup.toml"))
    run = vibrissa(capsys, "convert", log, "--setup", own, "-o", log.with_name("new.mat"))
    assert run.status == 2
    assert (log.read_bytes(), own.read_bytes()) == before


@pytest.mark.parametrize("target", ["x.mcap", "rosbag2:x"])
@pytest.mark.parametrize(
    ("row", "columns", "value", "said"),
    [
        (20, 0, "above", "of 40 rows 1 share a stamp with a row of another pose"),
        (20, slice(1, 8), np.nan, "of 40 rows 1 have no pose"),
        (39, slice(1, 8), np.nan, "of 40 rows 1 have no pose"),
        (20, 0, np.nan, "of 40 rows 1 have no stamp"),
    ],
)
def test_a_bag_refuses_rows_whose_pose_it_would_lose(
    row: int,
    columns: int | slice,
    value: object,
    said: str,
    target: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Stamps lead to poses there: a row that shares one, or has no pose, would be given another's.
    The other formats keep the row as it is.
    """
    monkeypatch.chdir(tmp_path)
    table = recording_table()
    table[row, columns] = table[row - 1, 0] if value == "above" else value
    np.savetxt("log.csv", table, fmt="%.17g", delimiter=",", header=HEADER, comments="")
    Path("setup.toml").write_text(SETUP, encoding="utf-8")
    run = vibrissa(capsys, "convert", "log.csv", "--setup", "setup.toml", "-o", target)
    assert run.status == 2 and said in run.err and len(run.err.splitlines()) == 1
    assert run.err.endswith("allowed are x.csv, x.parquet, x.nc and x.mat\n")
    setup = vb.load_setup("setup.toml")
    expected = vb.io.read_raw("log.csv", setup).raw
    for kept in ("x.csv", "x.parquet", "x.nc", "x.mat"):
        vb.io.convert_recording("log.csv", "setup.toml", kept)
        found = vb.io.read_raw(kept, setup).raw
        for part in ("time", "position", "orientation", "force", "torque"):
            np.testing.assert_array_equal(getattr(found, part), getattr(expected, part))


@pytest.mark.parametrize("target", ["x.mcap", "rosbag2:x"])
def test_a_gap_too_long_to_interpolate_stays_one_in_a_bag(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows without a pose for longer than longest_gap have no reactions on either side."""
    monkeypatch.chdir(tmp_path)
    table = recording_table()
    table[15:20, 1:8] = np.nan
    np.savetxt("log.csv", table, fmt="%.17g", delimiter=",", header=HEADER, comments="")
    Path("setup.toml").write_text(f"{SETUP}[recording]\nlongest_gap = 0.3\n", encoding="utf-8")
    vb.io.convert_recording("log.csv", "setup.toml", target)
    setup = vb.load_setup("x_setup.toml")
    with pytest.warns(RecordingNote, match="5 of 40 rows, first at"):
        found = vb.read_recording(target.removeprefix("rosbag2:"), setup)
    expected = vb.read_recording("log.csv", vb.load_setup("setup.toml"))
    assert np.flatnonzero(np.isnan(found.force[:, 0])).tolist() == [15, 16, 17, 18, 19]
    np.testing.assert_allclose(found.force, expected.force, rtol=0, atol=1e-12)


@pytest.mark.parametrize("target", TARGETS)
def test_one_row_is_read_back(target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of three numbers is not taken for three rows of one."""
    monkeypatch.chdir(tmp_path)
    np.savetxt("log.csv", recording_table()[:1], delimiter=",", header=HEADER, comments="")
    Path("setup.toml").write_text(SETUP, encoding="utf-8")
    assert vb.io.convert_recording("log.csv", "setup.toml", target).rows == 1
    found = vb.io.read_raw(target.removeprefix("rosbag2:"), vb.load_setup("setup.toml")).raw
    row = np.hstack([found.position, found.orientation, found.wrench])
    np.testing.assert_allclose(row, recording_table()[:1, 1:], rtol=0, atol=1e-9)
