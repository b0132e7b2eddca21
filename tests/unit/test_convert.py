"""`vibrissa convert`: what is written reads back to the same reactions, in every format."""

from pathlib import Path

import numpy as np
import pytest
from bench_files import SETUP, recording_table
from command_line import vibrissa

import vibrissa as vb

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
