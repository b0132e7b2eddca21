"""The bench that `vibrissa example bench` hands out, from its logs to points on the bar."""

from pathlib import Path

import numpy as np
import pytest
from command_line import status_of, vibrissa

import vibrissa as vb


def test_bench_calibrates_on_the_ball_and_finds_the_bar(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The truth is in examples/bench/README.md."""
    monkeypatch.chdir(tmp_path)
    assert status_of("example", "bench") == 0
    sweeps = ("bench/ball_1.csv", "bench/ball_2.csv")
    calibrated = "bench/calibrated.toml"
    assert status_of("calibrate", *sweeps, "--setup", "bench/setup.toml", "-o", calibrated) == 0
    setup = vb.load_setup(calibrated)
    assert setup.rod.length == pytest.approx(0.05, abs=2e-4)
    assert setup.rod.bending_stiffness == pytest.approx(206e9 * np.pi / 4 * 0.25e-3**4, rel=0.01)
    for name in ("bar_1", "bar_2"):
        found = vb.reconstruct(setup.rod, vb.read_recording(f"bench/{name}.csv", setup))
        sound = found.in_contact & (found.status == vb.Status.OK)
        x, _, z = found.point[sound].T
        error = np.hypot(x, z - 0.05) - 0.015
        assert sound.sum() > 500
        assert abs(np.median(error)) < 1e-4


def test_examples_are_listed_and_never_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    listed = vibrissa(capsys, "example").out.splitlines()
    names = [line.split()[0] for line in listed]
    assert names[0] == "bench" and "mug" in names and all(len(line.split()) > 3 for line in listed)
    assert status_of("example", "mug", "-o", tmp_path) == 0
    assert vb.load_case(tmp_path / "mug.toml").rod.length > 0
    again = vibrissa(capsys, "example", "mug", "-o", tmp_path)
    assert again.status == 2 and "mug.toml exists already" in again.err
    assert "allowed are bench" in vibrissa(capsys, "example", "cup").err
